"""The base of every stage's settings: typed, frozen, unknown keys refused."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """A stage's settings. Each field states its default and unit on its line."""

    model_config = ConfigDict(frozen=True, extra="forbid")
