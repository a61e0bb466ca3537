"""The verb ``import``."""

from __future__ import annotations

import click
import numpy as np

import bayesid
from bayesid.cli.options import FILE, UNUSED_SEED, names, numbers, show_progress
from bayesid.cli.terminal import say
from bayesid.errors import InputError
from bayesid.recordings.experiment import Sensor

_numbers = numbers("write numbers with commas between, 0,0,0.1")
_whole_numbers = numbers("write whole numbers with commas between, 0,3", kind=int)


def _pairs(_context, parameter, value: tuple[str, ...]) -> dict[str, str]:
    """Parts ``name=value`` of an option, separated by commas; a part without ``=`` goes on with the one before."""
    out: dict[str, str] = {}
    for text in value:
        last = None
        for part in text.split(","):
            name, equals, given = part.partition("=")
            if equals and name.strip():
                last = name.strip()
                out[last] = given.strip()
            elif last is not None:
                out[last] += "," + part.strip()
            else:
                raise InputError(f"{parameter.opts[0]} {part}: write NAME=VALUE")
    return out


def _number_pairs(context, parameter, value: tuple[str, ...]) -> dict[str, float]:
    out = {}
    for name, given in _pairs(context, parameter, value).items():
        try:
            out[name] = float(given)
        except ValueError:
            raise InputError(f"{parameter.opts[0]} {name}={given}: write a number") from None
    return out


@click.command(name="import")
@click.argument("sources", type=FILE, nargs=-1, required=True, metavar="SOURCE...")
@click.option(
    "--urdf", type=FILE, required=True,
    help='The robot: a URDF, a xacro file ("FILE name:=value"), an MJCF file, or robot_descriptions:NAME.',
)  # fmt: skip
@click.option("--out", type=FILE, required=True, help="The experiment folder to be made.")
@click.option(
    "--validation", type=FILE, multiple=True, help="A recording that is only predicted; default: the last of several sources."
)
@click.option("--mapping", type=FILE, help="A TOML file with [columns], [units] and [units.scale].")
@click.option("--columns", callback=_pairs, multiple=True, help='The log\'s names by ours: "t=Time,q={joint}/pos,fx=Fx".')
@click.option("--units", callback=_pairs, multiple=True, help='Units by quantity or column: "t=ms,q=deg,v=deg/s,tau=A".')
@click.option("--scale", callback=_number_pairs, multiple=True, help='Factors by column or joint: "elbow_joint=11.2" [N m/A].')
@click.option(
    "--joint-names", callback=_pairs, multiple=True, help="The log's names of joints by the URDF's: joint1=shoulder_pan,..."
)
@click.option("--shift", callback=_number_pairs, multiple=True, help="Added to the times of a quantity [s]: wrench=-0.03.")
@click.option("--joints", callback=names, help="Moving joints in the order of q1 ..., by commas; default: all with positions.")
@click.option(
    "--locked", callback=_number_pairs, multiple=True, help="Where other joints stand [rad or m], NAME=VALUE; default 0."
)
@click.option("--gravity", callback=_numbers, help="In the base frame [m/s^2]; default 0,0,-9.81.")
@click.option("--sensor", help='Where the wrench is measured: "base", or a joint; default: as the messages\' frame says.')
@click.option(
    "--sensor-translation", callback=_numbers, help="The sensor's origin in the base, or in the joint's child link [m]."
)
@click.option("--sensor-rpy", callback=_numbers, help="Its orientation, as in URDF [rad].")
@click.option(
    "--clock", type=click.Choice(["header", "log"]), help="Times of topics; default: headers' stamps, where there are any."
)
@click.option("--topics", callback=names, help="Topics of a bag to be read, by commas; default: joint states and wrenches.")
@click.option("--episodes", callback=_whole_numbers, help="Episodes of a LeRobot data set, by commas; default: all.")
@click.option("--hold-out", type=float, help="Share of a recording, its end, that is kept for validation, such as 0.3.")
@click.option("--rate", type=float, help="Samples a second of tables that hold no times, such as 500.")
@click.option(
    "--kind", type=click.Choice(["trajectory", "poses"]), default="trajectory",
    help="poses: every row is a separate pose at rest, and needs no time.",
)  # fmt: skip
@click.option("--join", is_flag=True, help="The sources are parts of one recording, such as a file a topic.")
@UNUSED_SEED
def import_(
    sources, urdf, out, validation, gravity, sensor, sensor_translation, sensor_rpy, join, episodes, topics, **options
) -> None:
    """Make an experiment folder of files of other tools: ROS bags, MCAP, CSV, Parquet, NPZ, MAT, HDF5, LeRobot."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already; name a folder that does not exist or remove it first")
    placed = sensor
    if sensor_translation is not None or sensor_rpy is not None:
        if sensor is None:
            raise InputError('--sensor-translation and --sensor-rpy need --sensor; write "base" or the name of its joint')
        placed = Sensor(
            None if sensor == "base" else sensor, np.array(sensor_translation or np.zeros(3)), np.array(sensor_rpy or np.zeros(3))
        )
    given = {} if gravity is None else {"gravity": gravity}
    with show_progress() as progress:
        progress("reading")
        imported = bayesid.read_recording(
            list(sources), urdf, validation=list(validation), sensor=placed, join_files=join, topics=topics or (),
            episodes=episodes or (), name=out.absolute().name, **given, **options,
        )  # fmt: skip
        folder = imported.write(out)
    say(imported)
    say(f"experiment: {folder}")
