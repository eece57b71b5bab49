"""Settings as people write them: presets, YAML files and ``stage.key=value``, laid over one another.

Later ones win: defaults < the driver's sensor preset < ``--preset`` files < ``--config`` file <
``--set stage.key=value``. An unknown key or a value out of range is an error with file, line and the
nearest known name.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from mfslam.config import Config
from mfslam.types import MfslamError


def preset_folder() -> Path:
    """Folder of the shipped presets: inside the package in a wheel, beside it in a checkout."""
    here = Path(__file__).resolve().parent
    for folder in (here / "configs", here.parent / "configs"):
        if folder.is_dir():
            return folder
    raise MfslamError(
        f"presets not found beside {here}: the installation is incomplete; install mfslam again"
    )


def preset_names() -> list[str]:
    return sorted(p.stem for p in preset_folder().glob("*.yaml"))


def preset_path(name: str) -> Path:
    """Path of a preset by its name, or of a YAML file by its path."""
    path = preset_folder() / f"{name}.yaml"
    if path.is_file():
        return path
    if Path(name).is_file():
        return Path(name)
    hint = did_you_mean(name, preset_names()) or "."
    raise MfslamError(f"no preset and no file {name!r}{hint} Presets: {', '.join(preset_names())}")


def load(
    files: Iterable[Path | str] = (), settings: Iterable[str] = (), otherwise: Iterable[str] = ()
) -> Config:
    """Defaults, overlaid by YAML files in order, then by ``stage.key=value`` settings. ``otherwise``: settings that hold
    where nobody says anything else.

    Raises MfslamError with file and line (or the setting) for anything that is not understood.
    """
    layers = Layers()
    for setting in otherwise:
        layers.set(setting)
    for file in files:
        layers.read(Path(file))
    for setting in settings:
        layers.set(setting)
    try:
        return Config.model_validate(layers.values)
    except ValidationError as error:
        raise MfslamError("\n".join(_explain(error, layers))) from None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The known name nearest to a misspelt one, as the end of a message; empty when none is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


# --- layers ------------------------------------------------------------------------------------------


KeyPath = tuple[str, ...]
_Leaf = tuple[KeyPath, Any, str]  # path of keys, value, where it was said


class Layers:
    """Nested ``values``, overlaid in turn; every one remembers where it was said. For any set of stages."""

    def __init__(self, defaults: dict[str, Any] | None = None) -> None:
        self.values: dict[str, Any] = defaults or {}
        self._origin: dict[KeyPath, str] = {}

    def read(self, file: Path) -> None:
        """Overlay a YAML file. Raises MfslamError with its line."""
        self._overlay(_yaml_file_leaves(file))

    def set(self, setting: str) -> None:
        """Overlay one ``stage.key=value``. Raises MfslamError."""
        self._overlay([_setting_leaf(setting)])

    def where(self, path: KeyPath) -> str:
        """File and line, or the setting, that last spoke of a key or of one above it."""
        said = (self._origin.get(path[:n]) for n in range(len(path), 0, -1))
        return next((where for where in said if where is not None), "defaults")

    def _overlay(self, leaves: Iterable[_Leaf]) -> None:
        for path, value, where in leaves:
            node = self.values
            for key in path[:-1]:
                node = node.setdefault(key, {})
                if not isinstance(node, dict):
                    raise MfslamError(f"{where}: {'.'.join(path)} was given a value and keys below it")
            node[path[-1]] = value
            for n in range(1, len(path) + 1):
                self._origin[path[:n]] = where


def _yaml_file_leaves(path: Path) -> Iterator[_Leaf]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        data = YAML(typ="rt").load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise MfslamError(f"{path}: expected a YAML text file, got binary data") from None
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise MfslamError(f"{path}:{line}: not valid YAML: {error.problem}") from None
    except (YAMLError, ValueError) as error:  # ValueError: an impossible date, for one
        raise MfslamError(f"{path}: not valid YAML: {error}") from None
    if data is None:
        return
    if not isinstance(data, dict):
        raise MfslamError(f"{path}:1: expected 'stage:' with keys below it; see `mfslam config`")
    yield from _yaml_leaves(data, (), path)


def _yaml_leaves(node: Any, path: KeyPath, file: Path) -> Iterator[_Leaf]:
    lines = node.lc.data or {}
    for key, value in node.items():
        line = lines.get(key, [node.lc.line])[0] + 1  # merged keys (<<) have no line of their own
        here = (*path, str(key))
        if isinstance(value, dict):
            yield from _yaml_leaves(value, here, file)
        else:
            yield here, value, f"{file}:{line}"


def _setting_leaf(setting: str) -> _Leaf:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    key, equals, text = setting.partition("=")
    if not equals or not key.strip():
        raise MfslamError(
            f"--set {setting}: expected stage.key=value, for example --set map.resolution_m=0.02"
        )
    try:
        value = YAML(typ="safe").load(text)
    except (YAMLError, ValueError):
        raise MfslamError(f"--set {setting}: the value {text.strip()!r} is not valid YAML") from None
    return tuple(key.strip().split(".")), value, f"--set {setting}"


def _explain(error: ValidationError, layers: Layers) -> Iterator[str]:
    for item in error.errors():
        path = tuple(str(p) for p in item["loc"])
        message = item["msg"]
        if item["type"] == "extra_forbidden":
            known = _known_keys(path[:-1])
            message = f"no such setting{did_you_mean(path[-1], known)} (known here: {', '.join(known)})"
        yield f"{layers.where(path)}: {'.'.join(path)}: {message}"


def _known_keys(path: KeyPath) -> list[str]:
    if not path:
        return list(Config.model_fields)
    stage = Config.model_fields.get(path[0])
    model = stage.annotation if stage else None
    return list(model.model_fields) if isinstance(model, type) and issubclass(model, BaseModel) else []


# --- telling -----------------------------------------------------------------------------------------


def describe(config: Config | None = None) -> str:
    """The whole config as YAML, every setting with its meaning (and unit) as a comment."""
    config = config or Config()
    out: list[str] = []
    for stage_name in Config.model_fields:
        stage: BaseModel = getattr(config, stage_name)
        doc = " ".join((type(stage).__doc__ or "").split())
        out.append(f"# {doc}")
        out.append(f"{stage_name}:")
        for key, info in type(stage).model_fields.items():
            out.append(f"  # {info.description}")
            out.append(f"  {key}: {json.dumps(getattr(stage, key))}")
        out.append("")
    return "\n".join(out)
