"""What one run is: a tree of dataclasses, read from and written to YAML.

A scenario file has one key, the scenario's name, and below it the fields of `Scenario`.
A box of the figure is chosen by its tag, `phase: !PaperPhase {}`: block X is configured
by the dataclass XConfig, whose fields stand below the tag. Fields left out take their
defaults. A tag with dots is the import path of a block of the user's own (`own_blocks`).
"""

import dataclasses
import difflib
import functools
import re
import typing
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_dump, yaml_dump_typed, yaml_load, yaml_load_typed
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.blocks.cables import CablesConfig, IndividualCablesConfig
from drake_nonstop.blocks.carrier_controller import (
    CarrierPidConfig,
    FeedforwardCarrierPidConfig,
    LoadedCarrierPidConfig,
    TunedCarrierPidConfig,
    TunedFeedforwardCarrierPidConfig,
)
from drake_nonstop.blocks.carrier_dynamics import (
    CarrierDynamicsConfig,
    IdealCarriersConfig,
    LoadedCarrierDynamicsConfig,
)
from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectoryConfig,
    InextensibleCarrierTrajectoryConfig,
    MeasuredCarrierTrajectoryConfig,
)
from drake_nonstop.blocks.force_distribution import (
    BoundedTensionDistributionConfig,
    CableForceDistributionConfig,
)
from drake_nonstop.blocks.internal_force import InternalForceTrajectoryConfig
from drake_nonstop.blocks.load_disturbance import NoDisturbanceConfig, WindConfig
from drake_nonstop.blocks.load_feedback import (
    DesiredStateFeedbackConfig,
    IdealFeedbackConfig,
    NoisyFeedbackConfig,
)
from drake_nonstop.blocks.load_plant import LoadPlantConfig, MultibodyLoadPlantConfig
from drake_nonstop.blocks.load_trajectory import (
    CircleConfig,
    ConstantVelocityMoveConfig,
    RestToRestConfig,
    SampledTrajectoryConfig,
    WaypointsConfig,
)
from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig, NonstopOptimizerConfig
from drake_nonstop.blocks.phase import AccumulatedPhaseConfig, PaperPhaseConfig
from drake_nonstop.blocks.wrench_controller import (
    GeometricPdConfig,
    PaperWrenchControllerConfig,
    TunedWrenchControllerConfig,
    WrenchControllerConfig,
)
from drake_nonstop.model.load_file import read_load
from drake_nonstop.model.pattern import (
    CarouselConfig,
    HamiltonianCycleConfig,
    LinearPatternConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import SystemOverrides, SystemParameters
from drake_nonstop.scenario.own_blocks import (
    import_config,
    import_path,
    is_import_path,
    make_importable,
)
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import (
    ScenarioError,
    require,
    require_non_negative,
    require_positive,
)

SCENARIOS = Path(__file__).parents[1] / "diagrams" / "scenarios"


def _default_simulator() -> SimulatorConfig:
    return SimulatorConfig(
        integration_scheme="runge_kutta3", max_step_size=0.005, use_error_control=False
    )


@dataclass(kw_only=True)
class Scenario:
    """The system, a config per box of the figure, and how to simulate them."""

    name: str = "unnamed"
    description: str = ""
    duration: float = 15.0  # s
    control_period: float = 0.01  # s, sample time of the controllers; 0: continuous
    fused_plant: bool = False  # load, cables, carriers and their controller in one fast block
    safe_carrier_distance: float = 0.1  # m; `run` warns where two carriers come closer
    safe_cable_distance: float = 0.1  # m; `run` warns where two cables come closer
    simulator: SimulatorConfig = field(default_factory=_default_simulator)
    system: SystemParameters = field(default_factory=SystemParameters)
    simulated: SystemOverrides = field(default_factory=SystemOverrides)
    pattern: (
        HamiltonianCycleConfig | CarouselConfig | SpreadCarouselConfig | LinearPatternConfig
    ) = field(default_factory=HamiltonianCycleConfig)
    load_trajectory: (
        RestToRestConfig
        | ConstantVelocityMoveConfig
        | WaypointsConfig
        | CircleConfig
        | SampledTrajectoryConfig
    ) = field(default_factory=RestToRestConfig)
    load_feedback: IdealFeedbackConfig | DesiredStateFeedbackConfig | NoisyFeedbackConfig = field(
        default_factory=IdealFeedbackConfig
    )
    wrench_controller: (
        WrenchControllerConfig
        | PaperWrenchControllerConfig
        | GeometricPdConfig
        | TunedWrenchControllerConfig
    ) = field(default_factory=WrenchControllerConfig)
    optimization_layer: NonstopOptimizerConfig | ConstantParametersConfig = field(
        default_factory=NonstopOptimizerConfig
    )
    phase: AccumulatedPhaseConfig | PaperPhaseConfig = field(default_factory=AccumulatedPhaseConfig)
    internal_force: InternalForceTrajectoryConfig = field(
        default_factory=InternalForceTrajectoryConfig
    )
    force_distribution: CableForceDistributionConfig | BoundedTensionDistributionConfig = field(
        default_factory=CableForceDistributionConfig
    )
    carrier_trajectory: (
        CarrierTrajectoryConfig
        | InextensibleCarrierTrajectoryConfig
        | MeasuredCarrierTrajectoryConfig
    ) = field(default_factory=CarrierTrajectoryConfig)
    carrier_controller: (
        CarrierPidConfig
        | TunedCarrierPidConfig
        | FeedforwardCarrierPidConfig
        | TunedFeedforwardCarrierPidConfig
        | LoadedCarrierPidConfig
    ) = field(default_factory=CarrierPidConfig)
    carrier_dynamics: CarrierDynamicsConfig | LoadedCarrierDynamicsConfig | IdealCarriersConfig = (
        field(default_factory=CarrierDynamicsConfig)
    )
    cables: CablesConfig | IndividualCablesConfig = field(default_factory=CablesConfig)
    load_disturbance: NoDisturbanceConfig | WindConfig = field(default_factory=NoDisturbanceConfig)
    load_plant: LoadPlantConfig | MultibodyLoadPlantConfig = field(default_factory=LoadPlantConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)

    @property
    def speed_bound(self) -> float:
        """The ε (m/s) that the optimization layer's config states; 0 where it states none."""
        return getattr(self.optimization_layer, "speed_bound", 0.0)


def scenario_names() -> list[str]:
    """The names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in SCENARIOS.glob("*.yaml"))


def load_scenario(
    name_or_file: str | Path, settings: Iterable[str] = (), *, trust: bool = False
) -> Scenario:
    """The scenario of that name, or the one in a YAML file.

    Args:
        name_or_file: one of `scenario_names()`, or the path of a `.yaml` file.
        settings: changes "path=value", such as "system.load_mass=1.2". A path names a
            field of the resolved scenario; a value is YAML. A box takes a tagged value
            ("phase=!PaperPhase {}"), or the name of another block ("phase=PaperPhase"),
            which takes over the parameters that both have (a trajectory: those not default).
        trust: whether blocks of the user's own may be imported, which runs their code; they
            are looked for in the current folder and the scenario's, too.

    Raises:
        ScenarioError: there is no such scenario or file, or its content cannot be used;
            the message names the field, the value and the remedy.
    """
    path = Path(name_or_file)
    if trust:
        make_importable(str(Path.cwd()))
    if path.suffix not in (".yaml", ".yml"):
        names = scenario_names()
        require(
            str(name_or_file) in names,
            "scenario",
            name_or_file,
            f"give a .yaml file or one of {', '.join(names)}",
        )
        path = SCENARIOS / f"{name_or_file}.yaml"
    elif trust:
        make_importable(str(path.parent.absolute()))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"scenario = {path}: give a file that can be read ({error})") from None
    scenario = parse_scenario(text, str(path), trust=trust)
    return changed(scenario, settings, trust=trust) if settings else scenario


def changed(scenario: Scenario, settings: Iterable[str], *, trust: bool = False) -> Scenario:
    """A copy of the scenario with changes "path=value", see `load_scenario`.

    Blocks of the user's own that the scenario has already are trusted.

    Raises:
        ScenarioError: a path or value cannot be used.
    """
    tree = _tree(scenario)
    trusted = True if trust else {entry["_tag"] for entry in _tagged(tree).values()}
    for setting in settings:
        _apply_setting(tree, setting, trusted)
    return _from_tree(scenario.name, tree, trusted)


def parse_scenario(text: str, source: str = "scenario", *, trust: bool = False) -> Scenario:
    """The scenario in YAML text; `source` is what error messages call the text.

    `trust` as in `load_scenario`.

    Raises:
        ScenarioError: see `load_scenario`.
    """
    node = _compose(text, source)
    require(
        isinstance(node, yaml.MappingNode) and len(node.value) == 1,
        source,
        "a file without exactly one scenario",
        "give one key, the scenario's name, with its fields below it",
    )
    ((name, content),) = _plain(node, source).items()
    content = {} if content is None else content
    require(isinstance(content, dict), name, content, "give the scenario's fields below its name")
    return _from_tree(name, content, trust)


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as YAML with every field and tag written out; `parse_scenario` reads it."""
    return yaml.dump(
        {scenario.name: _tree(scenario)},
        Dumper=_TreeDumper,
        sort_keys=False,  # the boxes stand in the figure's order
        default_flow_style=None,
        width=96,
    )


def parse_plain(text: str, source: str) -> Any:
    """YAML text as dicts, lists and scalars, read as strictly as a scenario.

    A dict that has a tag holds it under "_tag"; `source` as in `parse_scenario`.

    Raises:
        ScenarioError: the text is no YAML, or ambiguous.
    """
    node = _compose(text, source)
    return None if node is None else _plain(node, source)


def dump_plain(value: Any) -> str:
    """What `parse_plain` makes of YAML, as YAML in one line: the value of a setting."""
    text = yaml.dump(
        value, Dumper=_TreeDumper, sort_keys=False, default_flow_style=True, width=float("inf")
    )
    return text.removesuffix("...\n").strip()


class _TreeDumper(yaml.SafeDumper):
    """Writes "_tag" in a dict as the tag of its mapping."""

    def represent_tree(self, data: dict[str, Any]) -> yaml.Node:
        """A dict as a mapping, tagged where it holds a "_tag"."""
        fields = {key: value for key, value in data.items() if key != "_tag"}
        return self.represent_mapping(data.get("_tag", "tag:yaml.org,2002:map"), fields)


_TreeDumper.add_representer(dict, _TreeDumper.represent_tree)


def _tree(scenario: Scenario) -> dict[str, Any]:
    """Nested dicts with every field, each box with its block's name under "_tag"."""
    configs = {name: getattr(scenario, name) for name in _choices()}
    known = {}  # the scenario without blocks of the user's own, which its schema does not know
    for name, choices in _choices().items():
        is_own = dataclasses.is_dataclass(configs[name]) and import_path(configs[name])
        require(
            is_own or type(configs[name]) in choices,
            name,
            type(configs[name]).__name__.removesuffix("Config"),
            f"give one of {', '.join(map(_tag, choices))}",
        )
        if is_own:
            known[name] = choices[0]()
    plain = dataclasses.replace(scenario, **known)
    tree = yaml_load(data=yaml_dump_typed(plain, schema=Scenario), private=True)
    for name, config in configs.items():
        fields = tree[name]
        if name in known:
            fields = yaml_load(data=yaml_dump_typed(config, schema=type(config)), private=True)
        tag = import_path(config) or _tag(type(config))
        tree[name] = {**(fields or {}), "_tag": f"!{tag}"}
    del tree["name"]
    return tree


def _tagged(tree: dict[str, Any]) -> dict[str, Any]:
    """The entries of a tree that have a tag."""
    return {
        name: entry for name, entry in tree.items() if isinstance(entry, dict) and "_tag" in entry
    }


@functools.cache
def _choices() -> dict[str, tuple[type, ...]]:
    """The config classes that each tagged field of Scenario may hold."""
    result = {}
    for name, annotation in typing.get_type_hints(Scenario).items():
        options = typing.get_args(annotation) or (annotation,)
        is_tagged = all(option.__name__.endswith("Config") for option in options)
        if is_tagged and SimulatorConfig not in options:
            result[name] = options
    return result


def _tag(config_class: type) -> str:
    return config_class.__name__.removesuffix("Config")


def _from_tree(name: str, tree: dict[str, Any], trusted: bool | set[str]) -> Scenario:
    """The scenario of nested dicts such as `_tree` makes, of which any may be left out.

    `trusted` are the tags of blocks of the user's own that may be imported, or True for all.
    """
    require(
        re.fullmatch(r"[A-Za-z0-9][\w.-]*", name),
        "scenario",
        name,
        "name it with letters, digits, _, - and . only: its results' folder is named after it",
    )
    tree = dict(tree)
    _check_fields(name, tree, Scenario)
    require("name" not in tree, f"{name}.name", tree.get("name"), "leave it to the file's one key")
    own = {}
    for field_name, options in _choices().items():
        if field_name in tree:
            config_class, fields = _checked_entry(field_name, tree.pop(field_name), trusted)
            if config_class not in options:
                own[field_name] = _loaded(config_class, fields)
            else:
                tag = {"_tag": f"!{config_class.__name__}"} if len(options) > 1 else {}
                tree[field_name] = tag | fields
    for field_name, schema in (
        ("system", SystemParameters),
        ("simulated", SystemParameters),
        ("simulator", SimulatorConfig),
    ):
        if field_name in tree:
            tree[field_name] = {} if tree[field_name] is None else tree[field_name]
            _check_fields(field_name, tree[field_name], schema)
    scenario = yaml_load_typed(schema=Scenario, data=yaml_dump(tree), defaults=Scenario())
    scenario.name = name
    for field_name, config in own.items():
        setattr(scenario, field_name, config)
    for owner in ("system", "simulated"):
        system = getattr(scenario, owner)
        if system.load_file:
            fields = read_load(system.load_file, system.attachment_frames or [])
            fields |= {"load_file": "", "attachment_frames": []}  # the resolved scenario has both
            setattr(scenario, owner, dataclasses.replace(system, **fields))
    if isinstance(scenario.load_trajectory, SampledTrajectoryConfig):
        scenario.load_trajectory = scenario.load_trajectory.resolved()
    require_positive(name, duration=scenario.duration)
    require_non_negative(
        name,
        safe_carrier_distance=scenario.safe_carrier_distance,
        safe_cable_distance=scenario.safe_cable_distance,
    )
    simulator = scenario.simulator
    require_positive(
        "simulator", max_step_size=simulator.max_step_size, accuracy=simulator.accuracy
    )
    require(
        simulator.max_step_size >= 1e-5,
        "simulator.max_step_size",
        simulator.max_step_size,
        "give at least 1e-5 s, or the run would not come to an end",
    )
    require(simulator.start_time == 0, "simulator.start_time", simulator.start_time, "give 0")
    return scenario


def _checked_entry(name: str, entry: Any, trusted: bool | set[str]) -> tuple[type, dict[str, Any]]:
    """The config class of a box's entry, and its fields, which the class has."""
    entry = {} if entry is None else entry
    default = _tag(_choices()[name][0])
    require(
        isinstance(entry, dict), name, entry, f"name a block by its tag, such as !{default} {{}}"
    )
    fields = dict(entry)
    config_class = _config_class(name, fields.pop("_tag", f"!{default}"), trusted)
    _check_fields(name, fields, config_class)
    return config_class, fields


def _config_class(name: str, tag: str, trusted: bool | set[str]) -> type:
    """The config class that a box's tag stands for."""
    options = _choices()[name]
    block = tag.removeprefix("!")
    if is_import_path(block) and name != "scene":
        require(
            trusted is True or (trusted and tag in trusted),
            name,
            tag,
            "this scenario runs code of its own, from the module that the tag names; where you "
            "trust that code, give --trust (in Python: trust=True)",
        )
        return import_config(name, block)
    matching = [option for option in options if _tag(option) == block]
    require(matching, name, tag, f"give one of !{', !'.join(map(_tag, options))}")
    return matching[0]


def _loaded(config_class: type, fields: dict[str, Any]) -> Any:
    """A config of the user's own from its fields."""
    return yaml_load_typed(schema=config_class, data=yaml_dump(fields), defaults=config_class())


def _check_fields(name: str, tree: Any, schema: Any) -> None:
    """Raises ScenarioError for the first key that is no field, or value not of its type."""
    require(isinstance(tree, dict), name, tree, "give a mapping of fields to values")
    fields = dataclasses.fields(schema) if dataclasses.is_dataclass(schema) else schema.__fields__
    types = {f.name: f.type for f in fields}
    for key, value in tree.items():
        _require_known(key, types, f"{name}.{key}", value)
        _check_type(f"{name}.{key}", value, types[key])


def _require_known(
    key: Any, valid: Collection[str], field: str, value: Any, called: str = ""
) -> None:
    """Raises ScenarioError for a key that is not among the valid ones; `called` is its full name.

    Only then is a close one looked for, which takes longer than all else.
    """
    if key in valid:
        return
    name = called or key
    close = difflib.get_close_matches(str(name), valid, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    there = f"there is no {name}; {hint}there are {', '.join(valid) or 'no fields'}"
    require(False, field, value, there)


def _check_type(path: str, value: Any, annotation: Any) -> None:
    """Raises ScenarioError for a scalar or list that is not what the annotation says."""
    if typing.get_origin(annotation) is list:
        require(isinstance(value, list), path, value, "give a list in [ ]")
        for i, item in enumerate(value):
            _check_type(f"{path}[{i}]", item, typing.get_args(annotation)[0])
    elif annotation in _KINDS:
        accepted, kind = _KINDS[annotation]
        require(type(value) in accepted, path, value, f"give {kind}")


_KINDS: dict[type, tuple[tuple[type, ...], str]] = {
    float: ((int, float), "a number"),
    int: ((int,), "a whole number"),
    str: ((str,), "a text"),
    bool: ((bool,), "true or false"),
}


def _compose(text: str, source: str) -> yaml.Node | None:
    """The text as a tree of YAML nodes."""
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        problem = " ".join(str(getattr(error, "problem", None) or "unreadable").split())
        raise ScenarioError(f"{source} = line {line}, {problem}: give valid YAML") from None


def _plain(node: yaml.Node | None, path: str) -> Any:
    """A YAML node as dicts, lists and scalars, refusing what YAML lets pass in silence."""
    assert node is not None
    require(path.count(".") < 20, path[:60], "an alias of itself", "write the value out")
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        if not node.tag.startswith("tag:"):
            result["_tag"] = node.tag
        for key_node, value_node in node.value:
            require(
                isinstance(key_node, yaml.ScalarNode), path, "a key in brackets", "give text keys"
            )
            key = str(key_node.value)
            field_path = f"{path}.{key}"
            require(
                key not in result,
                field_path,
                f"given twice, again in line {key_node.start_mark.line + 1}",
                "give it once",
            )
            result[key] = _plain(value_node, field_path)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [_plain(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
    if not node.tag.startswith("tag:"):
        require(node.value == "", path, f"{node.tag} {node.value}", "give its fields in {}")
        return {"_tag": node.tag}  # a tag without {}
    assert isinstance(node, yaml.ScalarNode)
    quoted = node.style in ("'", '"')
    require(
        not (quoted and _is_number_text(node.value)),
        path,
        f"'{node.value}'",
        "give the number without quotes",
    )
    loader = yaml.SafeLoader("")
    try:
        value = loader.construct_object(node)
    except (ValueError, yaml.YAMLError):
        raise ScenarioError(f"{path} = {node.tag} {node.value}: give a plain value") from None
    is_sexagesimal = ":" in node.value and not isinstance(value, str)  # YAML 1.1: 1:30 is 90
    require(not is_sexagesimal, path, node.value, "give a number in plain digits")
    if isinstance(value, str) and not quoted and _is_number_text(value):
        value = float(value)  # YAML 1.1 takes 1e-3 for a string
    require(value == value, path, node.value, "give a finite number")
    return value


def _is_number_text(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _apply_setting(tree: dict[str, Any], setting: str, trusted: bool | set[str]) -> None:
    """Changes the resolved tree by one "path=value"."""
    path, separator, text = setting.partition("=")
    require(separator and path, "--set", setting, "give path=value")
    node = _compose(text, f"--set {path}")
    require(node is not None, f"--set {path}", "nothing", "give a value after the =")
    value = _plain(node, path)
    *parents, last = path.split(".")
    branch: Any = tree
    for i, key in enumerate(parents):
        parts = [part for part in branch if part != "_tag"]
        at = ".".join(parents[: i + 1])
        _require_known(key, parts, "--set", path, called=at)
        require(isinstance(branch[key], dict), "--set", path, f"{at} has no parts; set it whole")
        branch = branch[key]
    if path in _choices() and isinstance(value, str):
        value = _swapped(path, tree[path], value, trusted)
    branch[last] = value


def _swapped(
    name: str, entry: dict[str, Any], block: str, trusted: bool | set[str]
) -> dict[str, Any]:
    """The entry of another block in a box; parameters that both have stay as they were."""
    old = _config_class(name, entry["_tag"], trusted)
    types = typing.get_type_hints(_config_class(name, f"!{block}", trusted))
    shared = [key for key, kind in typing.get_type_hints(old).items() if types.get(key) == kind]
    kept = {key: entry[key] for key in shared if key in entry}
    if name == "load_trajectory":  # each task has times of its own, unless they were set
        default = dataclasses.asdict(old())
        kept = {key: value for key, value in kept.items() if value != default[key]}
    return {**kept, "_tag": f"!{block}"}
