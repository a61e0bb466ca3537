"""Four diagnoses: a hidden hose, two real robots, a real wrist sensor, and one that goes wrong.

    python case_studies/diagnosis/run.py [--out DIR] [--only hose,robot,wrist,failure]

writes results.json, the figures and README.md with its tables filled in. ``robot`` and ``wrist`` take the
recordings that `bayesid.datasets` finds or fetches, and are skipped without. All four take about ten minutes on one core.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from present import FIGURES, fill, plain, tables

import bayesid
from bayesid.diagnosis.locate import by_window, places_looked_at
from bayesid.diagnosis.validation import residual_spectra

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "blind_naming"))
FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
#: A soft hose from behind the shoulder to the middle of link 2: 12 N for each metre, slack below 0.45 m.
HOSE = {
    "stiffness": 12.0, "rest_length": 0.45, "anchor_x": -0.2, "anchor_y": -0.5, "anchor_z": 1.3,
    "point_x": 0.3, "point_y": 0.0, "point_z": 0.1,
}  # fmt: skip
#: Cubic part of the moment's reading at the largest moment of the fitted motions, over that moment.
SIZES = (0.001, 0.002, 0.003, 0.005, 0.01, 0.03)
#: Excursion [rad], speed [rad/s] and acceleration [rad/s^2] of both joints in a narrow and a wide motion.
NARROW, WIDE = (0.5, 1.2, 2.5), (0.9, 2.5, 8.0)


def recorded(
    folder: Path, seed: list[int], kind: str, effect: Callable[[Any], tuple], ranges: dict[str, tuple] | None = None
) -> dict[str, Any]:
    """Record the two-joint PUMA with the independent plant; what was hidden and the links as they are.

    Parameters
    ----------
    folder
        To be written.
    seed, kind
        Of the draw of arm, sensor and motions, and what kind of case it is.
    effect
        Gives name, place and values of the hidden effect for a setup of the plant.
    ranges
        Excursion, speed and acceleration by role, of Fourier motions that replace the drawn ones.
    """
    import cases
    import motions
    import plant

    rng = np.random.default_rng(seed)
    setup = cases.set_up(cases.Plan(folder.name, kind, (), None, "puma2", "wrench", False, 0.03), rng)
    if ranges is not None:
        references = []
        for name, role, t, (first, every, count), _ in setup.references:
            limits = np.repeat(np.array(ranges[role])[:, None], 2, axis=1)
            length = (count - 1) * every * (t[1] - t[0])
            references.append((name, role, t, (first, every, count), motions.fourier(t, length, setup.home, limits, rng)))
        setup = replace(setup, references=references)
        setup = replace(setup, motions=cases.move(setup, ()))
    name, where, values = effect(setup)
    hidden = (plant.Effect(name, where, values),)
    setup = replace(setup, motions=cases.move(setup, hidden))
    cases.record(setup, hidden, folder, rng)
    moments = {m.role: float(np.abs(plant.respond(setup.arm, setup.sensor, m).wrench[:, 4]).max()) for m in setup.motions}
    return {"values": values, "links": setup.arm.links.ravel(), "noise": setup.noise, "moments": moments}


def gap_of(d: bayesid.Diagnosis) -> dict[str, Any] | None:
    """Gap on the unseen motions, with every channel's."""
    if d.gap is None:
        return None
    sides = [np.concatenate(residual_spectra(d.data, d.data.unseen, fit)) for fit in (d.search.base, d.search.best)]
    sizes = np.sqrt([np.mean(side**2, axis=0) for side in sides]).T
    return d.gap.to_dict() | {"channels": {n: list(map(float, row)) for n, row in zip(d.data.channels.names, sizes, strict=True)}}


def outcome(d: bayesid.Diagnosis) -> dict[str, Any]:
    """Verdict, what was tried, gap and places of a diagnosis."""
    s = d.search
    tried = s.best.terms[len(s.base.terms) :]
    return {
        "verdict": d.verdict,
        "named": [f.term.effect.spec for f in d.found],
        "rivals": {f.term.effect.spec: [t.effect.spec for t, _ in f.rivals] for f in d.found if f.rivals},
        "tried": [
            {"effect": t.effect.spec, "values": dict(zip(t.effect.parameters, map(float, t.values), strict=True))}
            for t in tried
        ],
        "fitted": {
            "before": float(np.sqrt(s.base.chi2 / s.projector.rows)), "after": float(np.sqrt(s.best.chi2 / s.projector.rows)),
        },
        "gap": gap_of(d),
        "floor_known": d.data.floor_known, "floor_source": d.data.floor_source,
        "where": [w.to_dict() for w in d.where],
    }  # fmt: skip


def base_errors(result: bayesid.Identification, links: np.ndarray) -> list[dict[str, Any]]:
    """Base parameters against those of the true links."""
    truth = result.base.matrix @ links
    return [
        {"name": n, "truth": float(t), "value": float(v), "std": float(s), "sigmas": float((v - t) / s)}
        for n, t, v, s in zip(result.names, truth, result.values, result.std, strict=True)
    ]


def residuals(result: bayesid.Identification) -> dict[str, Any]:
    """Residual of the last moment channel on the validation motion, thinned for a figure."""
    (p,) = result.validation[:1]
    step = max(len(p.times) // 400, 1)
    left = p.measured[:, -1] - p.predicted[:, -1]
    return {"channel": p.channel_names[-1], "times": p.times[::step].tolist(), "left": left[::step].tolist()}


def hose(seed: int = 0) -> dict[str, Any]:
    """The paper's robot with a hose nobody told the model about."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "hidden-hose"
        truth = recorded(folder, [1998, seed], "single", lambda _: ("tether", "joint2", HOSE))
        experiment = bayesid.load_experiment(folder)
        without = bayesid.identify(experiment)
        d = bayesid.diagnose(experiment)
        d.write(Path(temporary) / "diagnosed")
        result = outcome(d) | {
            "force_std": truth["noise"]["force_std"], "torque_std": truth["noise"]["torque_std"],
            "base_before": base_errors(without, truth["links"]),
            "whitened_before": float(without.validation[0].whitened_rms), "residual_before": residuals(without),
        }  # fmt: skip
        result["parameters"] = [
            {"effect": f.term.effect.spec, "name": k, "unit": u, "value": float(v), "std": float(s), "truth": HOSE.get(k)}
            for f in d.found
            for k, v, s, u in zip(f.term.effect.parameters, f.term.values, f.std, f.term.effect.units, strict=True)
        ]
        if d.found:
            after = bayesid.identify(experiment.with_model(Path(temporary) / "diagnosed" / "model.toml"))
            result |= {
                "base_after": base_errors(after, truth["links"]),
                "whitened_after": float(after.validation[0].whitened_rms), "residual_after": residuals(after),
            }  # fmt: skip
    return result


def robot() -> dict[str, Any]:
    """Real arms against a rigid-body model, without and with friction."""
    out: dict[str, Any] = {}
    for name in ("kuka-lwr4", "ur10"):
        experiment = bayesid.datasets.load(name)
        out[name] = {
            "rigid": outcome(bayesid.diagnose(experiment, "torque")),
            "friction": outcome(bayesid.diagnose(experiment, "torque", effects=FRICTION)),
        }
    return out


def jolts(table: pd.DataFrame, edges: np.ndarray) -> list[float]:
    """Root mean square step of the accelerometer from sample to sample, by window."""
    steps = np.linalg.norm(np.diff(table[["accx", "accy", "accz"]].to_numpy(), axis=0), axis=1)
    return [float(np.sqrt(np.mean(steps[a : max(b - 1, a + 1)] ** 2))) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def wrist() -> dict[str, Any]:
    """A real wrist sensor: a quiet turn, and the same with hammer taps."""
    folder = bayesid.datasets.fetch("kuka-med-wrist")
    out: dict[str, Any] = {}
    for motion in ("baseline", "vibrations"):
        table = pd.read_csv(folder / f"{motion}.csv")
        robust = bayesid.identify(folder, motions=[motion], method="student")
        known = bayesid.diagnose(folder, motions=[motion], effects=["sensor_offset"])
        data = known.search.projector.data
        segment = data.segments[0]
        left = residual_spectra(data, [segment], known.search.best)[0]
        edges, energy, freedom, _ = by_window(segment, left, 1.0, places_looked_at([segment]))
        quarter = np.searchsorted(table["t"].to_numpy(), np.arange(0.0, table["t"].iloc[-1], 0.25))
        out[motion] = {
            "nothing_known": outcome(bayesid.diagnose(folder, motions=[motion])),
            "offset_known": outcome(known),
            "rejected": robust.estimate.details.rejected_windows,
            "window_starts": [float(segment.times[k]) for k in edges[:-1]],
            "left": np.sqrt(energy.sum(axis=1) / freedom.sum(axis=1)).tolist(),
            "jolt_starts": table["t"].to_numpy()[quarter[:-1]].tolist(),
            "jolts": jolts(table, quarter),
            "highest_hz": float(segment.frequencies.max()),
            "events": sorted(d.peak for d in known.where if d.event and d.motion == motion),
        }  # fmt: skip
    return out


def cubic(size: float) -> Callable[[Any], tuple]:
    """A moment ``my`` whose reading bends: at the largest moment of the fitted motions by this share."""

    def of(setup: Any) -> tuple:
        import plant

        fitted = [m for m in setup.motions if m.role == "identification"]
        largest = max(np.abs(plant.respond(setup.arm, setup.sensor, m).wrench[:, 4]).max() for m in fitted)
        return "cubic_moment", "my", {"coefficient": float(size / largest**2)}

    return of


def failure(sizes: tuple[float, ...] = SIZES) -> list[dict[str, Any]]:
    """A reading that bends, at growing sizes, proved on a motion of the same range and on a wider one."""
    out = []
    with tempfile.TemporaryDirectory() as temporary:
        for label, wide in (("same range", NARROW), ("wider", WIDE)):
            for size in sizes:
                folder = Path(temporary) / f"cubic-{label[:4]}-{size:g}"
                ranges = {"identification": NARROW, "validation": wide}
                truth = recorded(folder, [1998, 1], "unlisted", cubic(size), ranges)
                d = bayesid.diagnose(folder)
                shutil.rmtree(folder)
                about = {"size": size, "validation": label, "moments": truth["moments"]}
                out.append(outcome(d) | about | {"torque_std": truth["noise"]["torque_std"]})
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="folder for results.json, the figures and the filled README.md")
    parser.add_argument("--only", default="hose,robot,wrist,failure", help="which, by commas; the others stay as they are")
    options = parser.parse_args()
    studies = {"hose": hose, "robot": robot, "wrist": wrist, "failure": failure}
    chosen = options.only.split(",") if options.only else []
    if strange := set(chosen) - set(studies):
        parser.error(f"--only {','.join(sorted(strange))}: give some of {','.join(studies)}")
    options.out.mkdir(parents=True, exist_ok=True)
    known = HERE / "results.json"
    results = json.loads(known.read_text(encoding="utf-8")) if known.exists() else {}
    for name in chosen:
        try:
            results[name] = plain(studies[name](), digits=5)
        except bayesid.InputError as error:  # recordings that are not to be had
            print(f"{name} skipped: {error}")
            continue
        (options.out / "results.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    filled = fill((HERE / "README.md").read_text(encoding="utf-8"), tables(results))
    (options.out / "README.md").write_text(filled, encoding="utf-8")
    for name, draw in FIGURES.items():
        if name in results:
            draw(results[name], options.out / f"{name}.png")
    print(filled)


if __name__ == "__main__":
    main()
