"""Write configuration files for the projects that run the episodes. The task files are complete: a project uses one
instead of its own task file.

Paths assume that the export is linked as ``data/datasets/condvln`` in the project's checkout, beside its
``data/scene_datasets``. Success distances are set for SR, SPL, OSR and BSA; nDTW keeps R2R's 3 m. Keys follow VLN-CE's
``vlnce_task.yaml`` and ``rxr_vlnce_english_task.yaml``, habitat-lab's ``vln_r2r.yaml`` and the ANSR-v1 tasks of
Open-Nav and VLN-Zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import yaml

from condvln.export.place_graphs import PLACES
from condvln.export.report import ExportReport
from condvln.export.splits import SPLITS
from condvln.export.variants import RXR_LANGUAGES
from condvln.sources.family import composed_datasets
from schemas.config.constants import STEP_CEILING

__all__ = ["LINK", "consumer_files"]

LINK: Final = "data/datasets/condvln"
"""Path at which the configuration files expect the export."""

_SCENES: Final = "data/scene_datasets/"
_FIDELITY_DISTANCE: Final = 3.0
_RXR_HEIGHT: Final = 0.88
"""Height in metres of RxR-Habitat's agent and of its cameras."""
_FALLBACK_SUCCESS_DISTANCE: Final = 1.0
_ACTIONS: Final = ("STOP", "MOVE_FORWARD", "TURN_LEFT", "TURN_RIGHT")
_MEASUREMENTS: Final = (
    "DISTANCE_TO_GOAL", "SUCCESS", "SPL", "NDTW", "PATH_LENGTH", "ORACLE_SUCCESS", "STEPS_TAKEN",
)  # fmt: skip


_DUMPER: Final[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""libyaml's writer where PyYAML was built with it: the same bytes for these documents in a quarter of the time."""


class _WithoutAnchors(_DUMPER):  # type: ignore[misc]
    """A YAML dumper without anchors: repeated values are written in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def consumer_files(report: ExportReport) -> dict[str, str]:
    """Return the text of each configuration file by path below the export."""
    radius, mixed = _success_distance(report)
    split = next((s for s in ("val_unseen", "test", "val_seen", "train") if report.episodes.get(s)), "val_unseen")
    steps = report.most_steps or STEP_CEILING
    files = {
        "configs/vlnce/condvln_task.yaml": _vlnce("vlnce", "VLN-CE-v1", split, radius, steps),
        "configs/vlnce/condvln_oracle_task.yaml": _vlnce("oracle", "VLN-CE-v1", split, radius, steps),
        "configs/vlnce/condvln_rxr_task.yaml": _rxr(split, radius, steps, RXR_LANGUAGES[report.language]),
        "configs/habitat_lab/condvln.yaml": _habitat_lab(split, radius, steps),
        "configs/streamvln/condvln.yaml": _streamvln(split, radius, steps),
        "configs/open_nav/condvln_task.yaml": _ansr(split, radius, _OPEN_NAV, _WAYPOINTS),
        "configs/open_nav/condvln_experiment.yaml": _experiment("open_nav", split, trainer="schedulesampler-OPENNAV"),
        "configs/vln_zero/condvln_task.yaml": _ansr(split, radius, _VLN_ZERO, steps),
        "configs/vln_zero/condvln_experiment.yaml": _experiment(
            "vln_zero", split, _VLN_ZERO.root, early_stop=(100, 10)
        ),
        "configs/navid/condvln_task.yaml": _navid(split, radius, steps),
        "configs/navid/condvln_experiment.yaml": _experiment("navid", split, early_stop=(400, 25)),
        "configs/navila/condvln_task.yaml": _vlnce("vlnce", "VLN-CE-v1", split, radius, steps),
        "configs/navila/condvln_experiment.yaml": _experiment("navila", split, trainer="navila"),
    }
    if not any("oracle/" in name for name in report.files):
        del files["configs/vlnce/condvln_oracle_task.yaml"]
    composed = composed_datasets(scene for found in report.scenes.values() for scene in found)
    texts = {}
    for path, document in files.items():
        root = _VLN_ZERO.root if path.startswith("configs/vln_zero/") else ""
        own = _RXR_NOTE if path.endswith("rxr_task.yaml") else ()
        package = "# @package _global_\n" if path.startswith("configs/streamvln/") else ""
        text = yaml.dump(document, Dumper=_WithoutAnchors, sort_keys=False)
        texts[path] = package + _note(root, radius, mixed, composed, own) + text
    return texts


def _success_distance(report: ExportReport) -> tuple[float, bool]:
    """Return the most frequent success distance, and whether other success distances occur."""
    counts: dict[str, int] = {}
    for split in SPLITS:
        for value, count in report.shapes.get(split, {}).get("success_distance", {}).items():
            counts[value] = counts.get(value, 0) + count
    if not counts:
        return _FALLBACK_SUCCESS_DISTANCE, False
    return float(max(sorted(counts), key=lambda value: counts[value])), len(counts) > 1


@dataclass(frozen=True)
class _AnsrAgent:
    """Settings of one of the public evaluators of conditional episodes: step length, turn and actions of its agent, the
    folder of its data, and its simulator and measures.
    """

    root: str
    forward: float
    turn: int
    actions: tuple[str, ...] = ()
    simulator: dict[str, str] = field(default_factory=dict)
    measured: tuple[str, ...] = ()


_OPEN_NAV: Final = _AnsrAgent("", 0.25, 15, ("HIGHTOLOW",), {"TYPE": "Sim-v1"})
_WAYPOINTS: Final = 20
"""Step limit of Open-Nav, which counts waypoint moves, not steps."""
_MAP: Final = "TOP_DOWN_MAP_VLNCE"
_VLN_ZERO: Final = _AnsrAgent("VLN_CE/", 1.0, 30, measured=(_MAP,))


_RXR_NOTE: Final = (
    "# RxR's body is wider (0.18 m) than the one that routes were proven for (0.1 m). habitat-sim builds a navmesh for",
    "# it, on which a narrow passage may be shut. Actions of the ground truth are turns of 15° of the other body.",
    "# The text is in the instruction sensor; agents that read BERT features make them from it.",
)


def _note(root: str, radius: float, mixed: bool, composed: list[str], own: tuple[str, ...]) -> str:
    lines = [f"# Link the export as {root}{LINK} and put scene meshes below {root}{_SCENES}."]
    if composed:
        lines.append(f"# Of {', '.join(composed)}, which come in parts,")
        lines.append(f"# `condvln compose CONFIG --all {root}{_SCENES}` puts every scene where its episodes name it.")
    lines += [
        "# Name the task file as BASE_TASK_CONFIG_PATH in your agent's own experiment file. Its cameras are stock",
        "# VLN-CE's: keep your own where your agent has others.",
    ]
    if mixed:
        lines.append(f"# Some episodes have another success distance than {radius:g} m (info.success_distance);")
        lines.append("# `condvln evaluate` judges each by its own.")
    lines += own
    return "\n".join(lines) + "\n"


def _vlnce(variant: str, kind: str, split: str, radius: float, steps: int, root: str = "") -> dict[str, Any]:
    folder = f"{root}{LINK}/{variant}"
    truth = {"SUCCESS_DISTANCE": _FIDELITY_DISTANCE, "GT_PATH": folder + "/{split}/{split}_gt.json.gz"}
    return {
        "ENVIRONMENT": {"MAX_EPISODE_STEPS": steps},
        "SIMULATOR": {
            "FORWARD_STEP_SIZE": 0.25,
            "TURN_ANGLE": 15,
            "AGENT_0": {"SENSORS": ["RGB_SENSOR", "DEPTH_SENSOR"], "HEIGHT": 1.5, "RADIUS": 0.1},
            "HABITAT_SIM_V0": {"GPU_DEVICE_ID": 0, "ALLOW_SLIDING": True},
            "RGB_SENSOR": {"WIDTH": 224, "HEIGHT": 224, "HFOV": 90, "TYPE": "HabitatSimRGBSensor"},
            "DEPTH_SENSOR": {"WIDTH": 256, "HEIGHT": 256, "HFOV": 90},
        },
        "TASK": {
            "TYPE": "VLN-v0",
            "SENSORS": ["INSTRUCTION_SENSOR", "SHORTEST_PATH_SENSOR", "VLN_ORACLE_PROGRESS_SENSOR"],
            "INSTRUCTION_SENSOR_UUID": "instruction",
            "POSSIBLE_ACTIONS": list(_ACTIONS),
            "MEASUREMENTS": list(_MEASUREMENTS),
            "SUCCESS_DISTANCE": radius,
            "SUCCESS": {"SUCCESS_DISTANCE": radius},
            "SPL": {"SUCCESS_DISTANCE": radius},
            "ORACLE_SUCCESS": {"SUCCESS_DISTANCE": radius},
            "NDTW": dict(truth),
            "SDTW": dict(truth),
        },
        "DATASET": {
            "TYPE": kind,
            "SPLIT": split,
            "DATA_PATH": folder + "/{split}/{split}.json.gz",
            "SCENES_DIR": root + _SCENES,
        },
    }


def _ansr(split: str, radius: float, agent: _AnsrAgent, steps: int) -> dict[str, Any]:
    document = _vlnce("ansr", "ANSR-v1", split, radius, steps, agent.root)
    document["SIMULATOR"] |= {
        "ACTION_SPACE_CONFIG": "v0",
        "FORWARD_STEP_SIZE": agent.forward,
        "TURN_ANGLE": agent.turn,
        **agent.simulator,
    }
    task = document["TASK"]
    task["POSSIBLE_ACTIONS"] += agent.actions
    task["MEASUREMENTS"] += [*agent.measured, "COLLISIONS", "BRANCH_SELECTION_ACCURACY", "CONDITIONAL_SUCCESS_RATE"]
    task["BRANCH_SELECTION_ACCURACY"] = {"SUCCESS_DISTANCE": radius}
    if _MAP in agent.measured:
        task[_MAP] = {"GRAPHS_FILE": f"{agent.root}{LINK}/{PLACES}"}
    return document


def _navid(split: str, radius: float, steps: int) -> dict[str, Any]:
    """Return NaVid's task file. NaVid outputs angles; its evaluator splits them into turns of 30°, and reads VLN-CE's
    top-down map.
    """
    document = _vlnce("vlnce", "VLN-CE-v1", split, radius, steps)
    document["SIMULATOR"]["TURN_ANGLE"] = 30
    document["TASK"]["MEASUREMENTS"].append(_MAP)
    document["TASK"][_MAP] = {"GRAPHS_FILE": f"{LINK}/{PLACES}"}
    return document


def _rxr(split: str, radius: float, steps: int, language: str) -> dict[str, Any]:
    """Return RxR's task file, with RxR's agent size, cameras and actions (turns of 30°), but with the text sensor.
    RxR's own sensor reads BERT features of each text from files, which an export does not have.
    """
    document = _vlnce("rxr", "RxR-VLN-CE-v1", split, radius, steps)
    folder = f"{LINK}/rxr"
    document["TASK"]["NDTW"]["GT_PATH"] = document["TASK"]["SDTW"]["GT_PATH"] = (
        folder + "/{split}/{split}_{role}_gt.json.gz"
    )
    view = {"WIDTH": 640, "HEIGHT": 480, "HFOV": 79, "POSITION": [0, _RXR_HEIGHT, 0]}
    document["SIMULATOR"] |= {
        "TURN_ANGLE": 30,
        "TILT_ANGLE": 30,
        "ACTION_SPACE_CONFIG": "v1",
        "AGENT_0": {"SENSORS": ["RGB_SENSOR", "DEPTH_SENSOR"], "HEIGHT": _RXR_HEIGHT, "RADIUS": 0.18},
        "HABITAT_SIM_V0": {"GPU_DEVICE_ID": 0, "ALLOW_SLIDING": False},
        "RGB_SENSOR": view,
        "DEPTH_SENSOR": {**view, "MIN_DEPTH": 0.5, "MAX_DEPTH": 5.0},
    }
    document["TASK"]["SENSORS"] = ["INSTRUCTION_SENSOR"]
    document["TASK"]["POSSIBLE_ACTIONS"] += ["LOOK_UP", "LOOK_DOWN"]
    document["DATASET"] |= {
        "ROLES": ["guide"],
        "LANGUAGES": [language],
        "DATA_PATH": folder + "/{split}/{split}_{role}.json.gz",
    }
    return document


def _habitat_lab(split: str, radius: float, steps: int) -> dict[str, Any]:
    return {
        "defaults": ["/benchmark/nav/vln_r2r", "_self_"],
        "habitat": {
            "environment": {"max_episode_steps": steps},
            "task": {"measurements": {"success": {"success_distance": radius}}},
            "simulator": {"forward_step_size": 0.25, "turn_angle": 15},
            "dataset": {
                "type": "R2RVLN-v1",
                "split": split,
                "data_path": LINK + "/vlnce/{split}/{split}.json.gz",
                "scenes_dir": _SCENES,
            },
        },
    }


def _streamvln(split: str, radius: float, steps: int) -> dict[str, Any]:
    """Return ``config/vln_r2r.yaml`` of StreamVLN and JanusVLN, which InternNav's habitat evaluator also reads."""
    camera = {"width": 640, "height": 480, "hfov": 79}
    return {
        "defaults": [
            {"/habitat": "habitat_config_base"},
            {"/habitat/task": "vln_r2r"},
            {"/habitat/simulator/agents@habitat.simulator.agents.main_agent": "rgbd_agent"},
            {"/habitat/dataset/vln": "mp3d_r2r"},
            {"/habitat/task/lab_sensors": ["gps_sensor", "compass_sensor"]},
            "_self_",
        ],
        "habitat": {
            "environment": {
                "max_episode_steps": steps,
                "iterator_options": {"max_scene_repeat_steps": 50000, "shuffle": False},
            },
            "simulator": {
                "agents": {
                    "main_agent": {
                        "sim_sensors": {
                            "rgb_sensor": camera,
                            "depth_sensor": {**camera, "min_depth": 0.0, "max_depth": 10.0},
                        }
                    }
                },
                "forward_step_size": 0.25,
                "turn_angle": 15,
                "habitat_sim_v0": {"gpu_device_id": 0},
            },
            "task": {
                "measurements": {
                    "distance_to_goal": {"type": "DistanceToGoal", "distance_to": "POINT"},
                    "success": {"type": "Success", "success_distance": radius},
                    "spl": {"type": "SPL"},
                    "oracle_success": {"type": "OracleSuccess"},
                    "oracle_navigation_error": {"type": "OracleNavigationError"},
                }
            },
            "dataset": {
                "type": "R2RVLN-v1",
                "split": split,
                "scenes_dir": _SCENES,
                "data_path": LINK + "/vlnce/{split}/{split}.json.gz",
            },
        },
    }


def _experiment(
    name: str, split: str, root: str = "", *, trainer: str = "", early_stop: tuple[int, int] | None = None
) -> dict[str, Any]:
    """Return the content of a project's experiment file, ``configs/<name>/condvln_experiment.yaml``.

    early_stop : numbers of steps and of consecutive turns after which NaVid's loop gives up
    """
    evaluation: dict[str, Any] = {"SPLIT": split, "EPISODE_COUNT": -1}
    if early_stop is not None:
        steps, turns = early_stop
        evaluation |= {"IDENTIFICATION": "condvln", "EARLY_STOP_STEPS": steps, "EARLY_STOP_ROTATION": turns}
    return {
        "BASE_TASK_CONFIG_PATH": f"{root}{LINK}/configs/{name}/condvln_task.yaml",
        **({"TRAINER_NAME": trainer} if trainer else {}),
        "EVAL": evaluation,
        "RESULTS_DIR": f"results/{name}_condvln",
    }
