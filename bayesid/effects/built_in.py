"""The effects that come with the package. A new one is a class in one of the modules and its name here."""

from bayesid.effects.bodies import InertiaError, Payload, RotorMomentum
from bayesid.effects.drives import (
    CoupledFriction,
    CoupledTransmission,
    RotorInertia,
    Spring,
    TorqueDelay,
    TorqueGain,
    TorqueRipple,
)
from bayesid.effects.effect import Effect
from bayesid.effects.friction import (
    CoulombFriction,
    DahlFriction,
    DirectionalFriction,
    LoadFriction,
    PostureFriction,
    StribeckFriction,
    TorqueOffset,
    ViscousFriction,
    WarmingFriction,
)
from bayesid.effects.loads import ExternalContact, FluidDrag, Tether
from bayesid.effects.placement import Backlash, BaseCompliance, BaseTilt, EncoderOffset, JointFlexibility
from bayesid.effects.sensor import (
    SensorCrosstalk,
    SensorDelay,
    SensorDrift,
    SensorGain,
    SensorOffset,
    SensorRotation,
    SensorTranslation,
)

#: In the order in which they are listed and tried.
CLASSES: tuple[type[Effect], ...] = (
    SensorOffset, SensorDrift, SensorGain, SensorCrosstalk, SensorRotation, SensorTranslation, SensorDelay,
    BaseTilt, Payload, InertiaError, Tether, FluidDrag, RotorMomentum, JointFlexibility, Backlash, EncoderOffset, ExternalContact,
    BaseCompliance, ViscousFriction, CoulombFriction, TorqueOffset, StribeckFriction, LoadFriction, RotorInertia, TorqueGain,
    TorqueRipple, Spring, TorqueDelay, DirectionalFriction, PostureFriction, DahlFriction,
    WarmingFriction, CoupledTransmission, CoupledFriction,
)  # fmt: skip
