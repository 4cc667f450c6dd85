"""The keys a study may hold, section by section, for messages that name the nearest one."""

from __future__ import annotations

import typing

from pydantic import BaseModel


def known_keys(model: type[BaseModel], section: str = "") -> dict[str, tuple[str, ...]]:
    """Section → its keys; the top level is "". A choice of sections is `section:source`."""
    found = {section: tuple(model.model_fields)}
    for name, field in model.model_fields.items():
        inner = f"{section}.{name}" if section else name
        kinds = [kind for kind in _alternatives(field.annotation) if _is_model(kind)]
        for kind in kinds:
            source = kind.model_fields.get("source") if len(kinds) > 1 else None
            found |= known_keys(kind, f"{inner}:{source.default}" if source else inner)
    return found


def _alternatives(annotation: typing.Any) -> tuple[typing.Any, ...]:
    return typing.get_args(annotation) or (annotation,)


def _is_model(kind: typing.Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
