"""YAML as data: nothing in it runs, stands twice, or grows beyond what was written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

LARGEST = 500_000
"""Bytes of a YAML file; the reader takes some seconds for as many."""

NODES = 100_000
"""Values in a YAML file, each alias counted as all that it stands for."""


class DataLoader(yaml.SafeLoader):
    """Safe YAML in which a key may stand only once, as one given twice is a slip, and aliases cannot explode."""

    def get_single_node(self) -> yaml.Node | None:
        node = super().get_single_node()
        if node is not None and expanded_size(node) > NODES:
            raise yaml.YAMLError(f"it has more than {NODES} values, counting each alias as all that it stands for")
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} stands twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def expanded_size(root: yaml.Node) -> int:
    """Values in a tree in which every alias is a copy.

    Raises:
        yaml.YAMLError: if something stands for itself.
    """
    sizes: dict[int, int | None] = {}

    def size(node: yaml.Node) -> int:
        if id(node) in sizes:
            known = sizes[id(node)]
            if known is None:
                raise yaml.YAMLError(f"an alias stands for something that it is part of, {node.start_mark}")
            return known
        sizes[id(node)] = None
        children = () if isinstance(node, yaml.ScalarNode) else node.value
        pairs = isinstance(node, yaml.MappingNode)
        total = 1 + sum(size(c) for child in children for c in (child if pairs else (child,)))
        sizes[id(node)] = total
        return total

    return size(root)


def read_yaml(path: Path) -> Any:
    """The content of a YAML file.

    Raises:
        ValueError: naming the file and what is wrong with it; it may be missing.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it has {path.stat().st_size} bytes, and YAML of more than {LARGEST} is not read")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file; expected YAML in UTF-8") from None
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    try:
        return yaml.load(text, DataLoader)
    except RecursionError:
        raise ValueError(f"{path}: not valid YAML: it is nested too deeply") from None
    except Exception as error:  # a date or number that is none makes the reader fail in many ways
        raise ValueError(f"{path}: not valid YAML: {' '.join(str(error).split())[:300]}") from None
