"""Writing an experiment folder that reads back as the same numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from bayesid.argument_types import explains_types
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment
from bayesid.recordings.schema import check_document, dump_model
from bayesid.recordings.table import write_table
from bayesid.recordings.whole import whole_folder


@explains_types
def write_experiment(experiment: Experiment, folder: str | Path, extra: Mapping[str, str] | None = None) -> None:
    """Write an experiment folder that `bayesid.recordings.experiment.load_experiment` reads back as the same numbers.

    The folder appears whole or not at all.

    Parameters
    ----------
    experiment
        What to write.
    folder
        A folder that does not exist yet, or is empty.
    extra
        Texts of other files to go with it, by name.

    Raises
    ------
    InputError
        The folder has something in it, is a file, or cannot be written; a name or number is none that a folder may have; or a
        motion is read in chunks, of which only an excerpt is in memory.
    """
    folder = Path(folder)
    for motion in experiment.motions:
        if motion.stored is not None:
            raise InputError(
                f"motion '{motion.name}': {motion.table.source} is read in chunks and not written again; "
                "copy the folder that it is in"
            )
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: is there already; name a folder that does not exist or remove it first")
        with whole_folder(folder) as made:
            _write_into(experiment, made)
            for name, text in (extra or {}).items():
                (made / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error}); name another folder") from None


def _write_into(experiment: Experiment, folder: Path) -> None:
    (folder / "robot.urdf").write_bytes(experiment.robot.description.data)
    robot: dict[str, Any] = {"urdf": "robot.urdf", "joints": list(experiment.robot.joint_names)}
    robot |= {"locked": dict(experiment.locked)} if experiment.locked else {}
    robot["gravity"] = [float(g) for g in experiment.robot.gravity]
    for key in ("inertia_rel_std", "position_resolution", "position_std"):
        value = getattr(experiment, key)
        robot |= {} if value is None else {key: float(value)}
    robot |= {"gear_ratio": dict(experiment.gear_ratio)} if experiment.gear_ratio else {}
    document: dict[str, Any] = {"format": 1, "name": experiment.name, "robot": robot}
    if (sensor := experiment.sensor) is not None:
        given = {
            "joint": sensor.joint, "translation": sensor.translation.tolist(), "rpy": sensor.rpy.tolist(),
            "force_std": sensor.force_std, "torque_std": sensor.torque_std,
        }  # fmt: skip
        document["sensor"] = {key: value for key, value in given.items() if value is not None}
    expressions = experiment.library.expressions
    if experiment.effects or experiment.effect_values or expressions:
        document["model"] = dump_model(experiment.effects, experiment.effect_values, expressions)
    document["motion"] = []
    stems: set[str] = set()
    for motion in experiment.motions:
        stem = re.sub(r"[^A-Za-z0-9_-]+", "_", motion.name)
        while f"{stem}.csv".lower() in stems or f"{stem}_static.csv".lower() in stems:
            stem += "_"
        section: dict[str, Any] = {"name": motion.name, "role": motion.role, "kind": motion.kind, "table": f"{stem}.csv"}
        write_table(motion.table, folder / section["table"])
        if motion.static is not None:
            section["static"] = f"{stem}_static.csv"
            write_table(motion.static, folder / section["static"])
        stems |= {f"{stem}.csv".lower(), f"{stem}_static.csv".lower()}
        section |= {} if motion.period is None else {"period": float(motion.period)}
        section |= {"parked": [list(map(float, interval)) for interval in motion.parked]} if motion.parked else {}
        document["motion"].append(section)
    check_document(document)
    (folder / "experiment.toml").write_text(tomli_w.dumps(document), encoding="utf-8")
