from .effect import Effect, Linearisation, Parameter, Surroundings, Term
from .exact import columns, readings, rigid_columns
from .expressions import variables
from .families import (
    BodyEffect,
    EncoderEffect,
    FlexibleJointEffect,
    GravityEffect,
    InstrumentEffect,
    JointDelayEffect,
    JointGainEffect,
    JointMotion,
    JointTorqueEffect,
    LoadEffect,
    MountEffect,
    PlayEffect,
    ReadingEffect,
    Readout,
    RotorEffect,
    SensorEffect,
    TransmissionEffect,
)
from .library import EffectLibrary, load_effects
from .linearised import Point, linearised, reach_of, starting_point, stated_of
from .loads import ExternalContact
from .model import Model
from .segment import REST_SPEED, MotionSegment, middle_of

__all__ = [
    "REST_SPEED",
    "BodyEffect",
    "Effect",
    "EffectLibrary",
    "EncoderEffect",
    "ExternalContact",
    "FlexibleJointEffect",
    "GravityEffect",
    "InstrumentEffect",
    "JointDelayEffect",
    "JointGainEffect",
    "JointMotion",
    "JointTorqueEffect",
    "Linearisation",
    "LoadEffect",
    "Model",
    "MotionSegment",
    "MountEffect",
    "Parameter",
    "PlayEffect",
    "Point",
    "ReadingEffect",
    "Readout",
    "RotorEffect",
    "SensorEffect",
    "Surroundings",
    "Term",
    "TransmissionEffect",
    "columns",
    "linearised",
    "load_effects",
    "middle_of",
    "reach_of",
    "readings",
    "rigid_columns",
    "starting_point",
    "stated_of",
    "variables",
]
