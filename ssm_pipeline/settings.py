"""The base of every stage's settings: typed, frozen, unknown keys refused."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """A stage's settings. Each field states its default and unit on its line."""

    # A case id may look like a number: `template: 12`. No setting means anything at infinity.
    model_config = ConfigDict(
        frozen=True, extra="forbid", coerce_numbers_to_str=True, allow_inf_nan=False
    )
