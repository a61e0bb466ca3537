"""The effects that come with the package. A new one is a class in one of the modules and its name here."""

from bayesid.effects import bodies, drives, friction, loads, placement, sensor
from bayesid.effects.effect import Effect

#: In the order in which they are listed and tried.
CLASSES: tuple[type[Effect], ...] = (
    sensor.SensorOffset, sensor.SensorDrift, sensor.SensorGain, sensor.SensorCrosstalk, sensor.SensorRotation,
    sensor.SensorTranslation, sensor.SensorDelay, placement.BaseTilt, bodies.Payload, bodies.InertiaError, loads.Tether,
    loads.FluidDrag, bodies.RotorMomentum, placement.JointFlexibility, placement.Backlash, placement.EncoderOffset,
    loads.ExternalContact, placement.BaseCompliance, friction.ViscousFriction, friction.CoulombFriction, friction.TorqueOffset,
    friction.StribeckFriction, friction.LoadFriction, drives.RotorInertia, drives.TorqueGain, drives.TorqueRipple,
    drives.Spring, drives.TorqueDelay, friction.DirectionalFriction, friction.PostureFriction, friction.DahlFriction,
    friction.WarmingFriction, drives.CoupledTransmission, drives.CoupledFriction,
)  # fmt: skip
