"""Read YAML for settings: case ids stay text, and a key that is given twice is an error.

YAML 1.1, which PyYAML reads, takes `007` for 7, `1:30` for 90, `NO` for false and `2020-01-01` for
a date. All of these occur as case ids. (`1e-3` stays text too; number settings parse it.)
"""

from __future__ import annotations

import re
from typing import Any

import yaml

DEEPEST = 50  # nested sections; without a limit, 100 000 brackets crash the process


class SettingsLoader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
    """PyYAML's safe loader with the scalars of YAML 1.2.

    Raises:
        YAMLError: For a repeated key.
    """

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self.depth += 1
        if self.depth > DEEPEST:
            raise yaml.MarkedYAMLError(problem=f"more than {DEEPEST} sections within each other")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = getattr(key_node, "value", None)
            if isinstance(key, str) and key in seen and key != "<<":
                raise yaml.MarkedYAMLError(
                    problem=f"the key {key} is given twice", problem_mark=key_node.start_mark
                )
            seen.add(key if isinstance(key, str) else None)
        result: dict[Any, Any] = super().construct_mapping(node, deep)
        return result


# Each is a subset of YAML 1.1's patterns, so that dumped settings can be read back.
SettingsLoader.yaml_implicit_resolvers = {}
for tag, pattern, first in (
    ("null", r"~|null|Null|NULL|", [*"~nN", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", [*"-+0123456789"]),
    (
        "float",
        r"[-+]?(?:0|[1-9][0-9]*)?\.[0-9]+(?:[eE][-+][0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
    ("merge", r"<<", ["<"]),
):
    SettingsLoader.add_implicit_resolver(
        f"tag:yaml.org,2002:{tag}", re.compile(f"(?:{pattern})$"), first
    )
