"""Effects beyond rigid bodies: what they are called, what they do to a reading, exactly, and its derivatives."""

from bayesid.effects.catalogue import CONTACT_RAMP, KINDS, REST_SPEED, Kind
from bayesid.effects.effect import Effect, Scene, State, Term, middle_of, parse_effects, places
from bayesid.effects.exact import columns, readings, rigid_columns
from bayesid.effects.linearised import PLAIN, Point, linearised, moved, reach_of, starting_point
from bayesid.effects.model import SOFT
from bayesid.effects.sizes import typical

__all__ = [
    "CONTACT_RAMP", "KINDS", "PLAIN", "REST_SPEED", "SOFT", "Effect", "Kind", "Point", "Scene", "State", "Term", "columns",
    "linearised", "middle_of", "moved", "parse_effects", "places", "reach_of", "readings", "rigid_columns", "starting_point",
    "typical",
]  # fmt: skip
