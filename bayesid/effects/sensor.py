"""Effects in the force/torque sensor."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects.effect import Parameter
from bayesid.effects.families import SensorEffect
from bayesid.effects.segment import MotionSegment

_LOADS = ("N",) * 3 + ("N m",) * 3
# A strain-gauge platform under an arm: tens of newtons [N, N m]; drift per second is a thousandth.
_OFFSET = (14.0, -9.0, 26.0, 1.6, -2.1, 0.7)


class _OnTop(SensorEffect):
    """Six constants, or six slopes in time, beside whatever the sensor feels."""

    zero_unless_stated = True

    @property
    def from_motion_alone(self):
        return True

    @abstractmethod
    def course(self, segment: MotionSegment) -> np.ndarray:
        """Reading that one unit of the parameter adds (N,)."""

    def columns(self, chain, segment, true, values):
        return self.course(segment)[:, None, None] * np.eye(6)

    def motion_columns(self, segment, channels):
        out = np.zeros((len(segment.times), len(channels), 6))
        for k, axis in enumerate(WRENCH_NAMES):
            if axis in channels:
                out[:, channels.index(axis), k] = self.course(segment)
        return out


class SensorOffset(_OnTop):
    name = "sensor_offset"
    summary = "constant bias of the sensor"
    equation = "$w + o$"
    quantities = tuple(Parameter(n, u, typical=o) for n, u, o in zip(WRENCH_NAMES, _LOADS, _OFFSET, strict=True))
    confusable_with = ("base_tilt", "payload")
    removed_by_static_run = True
    estimated_without_static_run = True
    absorbs_weight = True
    always_the_same = True

    def sought(self, around):
        return not around.static_run

    def course(self, segment):
        return np.ones(len(segment.times))

    def applied(self, chain, values):
        return replace(chain, offset=chain.offset + np.array(values))


class SensorDrift(_OnTop):
    name = "sensor_drift"
    summary = "bias that grows with time"
    equation = "$w + d\\,t$, with $t$ of the table, which may number poses; a static run is read after re-zeroing and has none"
    quantities = tuple(Parameter(n, f"{u}/s", typical=1e-3 * o) for n, u, o in zip(WRENCH_NAMES, _LOADS, _OFFSET, strict=True))
    confusable_with = ("tether",)
    since_zero = True

    def course(self, segment):
        return segment.elapsed

    def applied(self, chain, values):
        return replace(chain, drift=chain.drift + np.array(values))


class _Mixing(SensorEffect):
    """One axis reads a share of one; the source is the first of ``axes``, the reading axis the last."""

    def applied(self, chain, values):
        mix = chain.mix.copy()
        mix[self.axes[-1], self.axes[0]] += values[0]
        return replace(chain, mix=mix)

    def columns(self, chain, segment, true, values):
        out = np.zeros((len(segment.times), 6, 1))
        out[:, self.axes[-1], 0] = chain.sensed(segment, true[:, :, None])[:, self.axes[0], 0]
        return out


class SensorGain(_Mixing):
    name = "sensor_gain"
    at = "axis"
    summary = "one axis reads (1 + gain) times the truth"
    equation = "$(1 + g)\\,w_i$"
    quantities = (Parameter("gain", "1", -0.9, 2.0, typical=0.03),)
    confusable_with = ("sensor_crosstalk", "base_compliance")


class SensorCrosstalk(_Mixing):
    name = "sensor_crosstalk"
    at = "axis->axis"
    summary = "one axis reads a share of another"
    equation = "$w_k + c\\,w_i$"
    quantities = (Parameter("coefficient", "1", -1.0, 1.0, typical=0.02),)
    confusable_with = ("sensor_rotation", "sensor_translation", "base_tilt")

    @property
    def units(self):
        source, reading = (_LOADS[axis] for axis in self.axes)
        return ("1",) if source == reading else (f"{reading} per {source}",)


class SensorRotation(SensorEffect):
    name = "sensor_rotation"
    summary = "the sensor is turned against its stated pose"
    equation = "$\\exp([r]_\\times)^\\top$ times force and moment"
    quantities = tuple(
        Parameter(n, "rad", -0.5, 0.5, typical=x, linear=False) for n, x in (("rx", 0.01), ("ry", -0.015), ("rz", 0.02))
    )
    confusable_with = ("base_tilt", "encoder_offset", "sensor_crosstalk")

    def applied(self, chain, values):
        return replace(chain, turn=chain.turn + np.array(values))


class SensorTranslation(SensorEffect):
    name = "sensor_translation"
    summary = "the sensor is shifted against its stated pose"
    equation = "moments about the origin shifted by $d$, in base axes (for a sensor in a joint: in that joint's link)"
    quantities = tuple(Parameter(n, "m", -1.0, 1.0, typical=x) for n, x in (("x", 0.004), ("y", -0.003), ("z", 0.005)))
    confusable_with = ("sensor_crosstalk",)

    def applied(self, chain, values):
        return replace(chain, shift=chain.shift + np.array(values))

    def columns(self, chain, segment, true, values):
        # Linear, but its slope is wanted at the turned and delayed axes: one step of it, from zero.
        parts = []
        for unit in np.eye(3):
            moved = np.einsum("ij,nj->ni", self.applied(chain, tuple(unit)).pose - chain.pose, true)
            parts.append(segment.late(moved, chain.delay) @ chain.mix.T)
        return np.stack(parts, axis=-1)


class SensorDelay(SensorEffect):
    name = "sensor_delay"
    summary = "the sensor reads the wrench of a moment ago"
    equation = "$w(t - T)$"
    quantities = (Parameter("delay", "s", -0.1, 0.1, typical=0.004, linear=False),)
    confusable_with = ("fluid_drag", "joint_flexibility")

    def reach(self, values, bandwidth, step):
        return abs(values[0]) + 20.0 * step

    def applied(self, chain, values):
        return replace(chain, delay=chain.delay + values[0])
