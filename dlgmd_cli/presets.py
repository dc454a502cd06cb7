"""The paper's parameter sets and users' YAML files, read without trusting them."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.params import DlgmdParameters, Parameters, ParametersT
from dlgmd_cli.params.base import shown

MAX_CONFIG_BYTES = 100_000
# Of lists and mappings within each other; run.yaml has four.
MAX_DEPTH = 20
# What run.yaml records beside the parameters; it takes no part when the file is read back.
RECORD_KEYS = frozenset(
    [
        "input",
        "processed",
        "frames",
        "sweep",
        "versions",
        "warnings",
        "complete",
        "summary",
        "wall_s",
    ]
)


@dataclass(frozen=True)
class Config:
    """One file's say: the model, its parameters, and the run that made the file."""

    name: str
    model: str | None = None
    engine: str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)


class _Loader(yaml.SafeLoader):
    """Safe YAML in which a number is what it looks like: 1e-3 is one, 1:30 and 007 are none."""

    yaml_implicit_resolvers = {  # noqa: RUF012, PyYAML's own way
        first: [pair for pair in pairs if pair[0].rpartition(":")[2] in ("bool", "null")]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A dict, in which no key may stand twice."""
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value!r} stands twice", key.start_mark
                )
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)


for _tag, _pattern, _first in (
    ("int", r"[-+]?(0|[1-9]\d*|0x[0-9a-fA-F]+)", "-+0123456789"),
    (
        "float",
        r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
):
    _Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
        f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )


def presets_dir() -> Path:
    """The folder of `setN.yaml`: inside an installed package, beside it in the repository."""
    package = Path(__file__).resolve().parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def preset_names() -> list[str]:
    """The names that `--set` takes, in order."""
    return sorted(
        (path.stem.removeprefix("set") for path in presets_dir().glob("set*.yaml")),
        key=lambda name: (len(name), name),
    )


def load_preset(name: str | int) -> Config:
    """The paper's set `name`; raises ParameterError if there is none."""
    names = preset_names()
    if str(name) not in names:
        raise ParameterError(
            "", f"there is no set {str(name)[:40]}", f"Choose {names[0]} to {names[-1]}."
        )
    return load_config(presets_dir() / f"set{name}.yaml")


def load_model_preset(model: str) -> Config:
    """The published values of a model that the D-LGMD is compared with.

    Raises
    ------
    ParameterError
        If there is no such model.
    """
    return load_config(presets_dir() / f"{model}.yaml")


def load_set(name: str | int, **overrides: Any) -> DlgmdParameters:
    """The paper's parameter set `name`, 1 to 9, with single keys overridden.

    Raises
    ------
    ParameterError
        If there is no such set, or an override is not valid.

    Examples
    --------
    >>> load_set(9, r=4).sigma_e
    1.5
    """
    return DlgmdParameters.from_mapping({**load_preset(name).values, **overrides})


def load_config(path: Path) -> Config:
    """Read a YAML file of parameters; a `run.yaml` is one too.

    Raises
    ------
    ParameterError
        If the file cannot be read, is not plain YAML, or is not a mapping.
    """
    name = str(path)
    document = _parse(name, _read(path))
    if document is None:
        raise ParameterError(name, "it is empty", "Give at least one 'key: value'.")
    if not isinstance(document, dict):
        raise ParameterError(
            name,
            f"it holds {_KINDS.get(type(document), 'one value')}, not 'key: value' lines",
            _SHOW_HINT,
        )
    for key in document:
        if not isinstance(key, str):
            raise ParameterError(name, f"unknown parameter {shown(key)!r}", _SHOW_HINT)
    names = {key: document.pop(key, None) for key in ("model", "engine")}
    for key, word in names.items():
        if word is not None and not isinstance(word, str):
            raise ParameterError(name, f"{key} is not a name", _SHOW_HINT)
    options = document.pop("options", None)
    if options is not None and not isinstance(options, dict):
        raise ParameterError(name, "options is not a mapping", _SHOW_HINT)
    values = {key: value for key, value in document.items() if key not in RECORD_KEYS}
    return Config(name, **names, values=values, options=options or {})


_KINDS: dict[type, str] = {list: "a list", str: "mere text"}
_PLAIN = "Only plain numbers, true, false and names are read."
_SHOW_HINT = "See 'dlgmd sets show 9' for one that works."


def _read(path: Path) -> str:
    """The text of a file that is small enough to be a configuration."""
    name = str(path)
    try:
        if not path.is_file():
            why = "it is not a file" if path.exists() else "there is no such file"
            raise ParameterError(name, why, "Check the path given to --config.")
        with path.open("rb") as file:  # some are longer than they say
            data = file.read(MAX_CONFIG_BYTES + 1)
        size = max(path.stat().st_size, len(data))
        if size > MAX_CONFIG_BYTES:
            raise ParameterError(
                name, f"{size / 1e6:.1f} MB is too large for a configuration", _SHOW_HINT
            )
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise ParameterError(name, "it is not UTF-8 text", _SHOW_HINT) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ParameterError(name, f"it cannot be read ({reason})") from None


def _parse(name: str, text: str) -> Any:
    """The document in `text`; tags and references, which no configuration needs, are refused."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_Loader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:  # the parser's time grows with its square
                raise ParameterError(name, "its values are nested too deeply", _SHOW_HINT)
            tag, anchor = getattr(event, "tag", None), getattr(event, "anchor", None)
            if tag is not None or anchor is not None:
                what = f"the tag {tag!r}" if tag is not None else f"the reference {anchor!r}"
                raise ParameterError(name, f"{what[:200]} is not allowed", _PLAIN)
        return yaml.load(text, Loader=_Loader)
    except yaml.constructor.ConstructorError as error:
        problem = (error.problem or "it cannot be built").splitlines()[0][:200]
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ParameterError(name, f"{problem}{line}", _PLAIN) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" in line {mark.line + 1}" if mark else ""
        raise ParameterError(name, f"it is not valid YAML{where}", _SHOW_HINT) from None
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError):
        raise ParameterError(name, "it is not valid YAML", _SHOW_HINT) from None


def parse_overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """`KEY=VALUE` strings, each value read as YAML; raises ParameterError."""
    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise ParameterError(_PARAM, f"{pair[:60]!r} is not KEY=VALUE", "Write r=4.")
        values[key.strip()] = _parse(_PARAM, text) if len(text) < 1000 else text
    return values


_PARAM = "Invalid value for '--param'"


def merge(
    kind: type[ParametersT], config: Config | None, overrides: Mapping[str, Any]
) -> ParametersT:
    """Defaults, then `config`, then `overrides`, blaming whichever is at fault.

    Raises
    ------
    ParameterError
        If a key is unknown or a value is not valid.
    """
    values = dict(config.values) if config else {}
    try:
        return kind.from_mapping({**values, **overrides})
    except ParameterError as error:
        if config and (fault := _fault(kind, values)):
            raise ParameterError(config.name, fault.why, fault.mend) from None
        raise ParameterError(_PARAM, error.why, error.mend) from None


def _fault(kind: type[Parameters], values: Mapping[str, Any]) -> ParameterError | None:
    """What is wrong with `values`, if anything."""
    try:
        kind.from_mapping(values)
    except ParameterError as error:
        return error
    return None
