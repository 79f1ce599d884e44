"""Speed against accuracy, measured: cases with a known answer, or a scene of one's own, over the knobs that matter.

Every run is a `Quality` applied to a case's own numbers: one knob at a time, a designed set of several, and the
named qualities. `tools/tradeoff.py` makes docs/accuracy.md from them; `melp-warp tradeoff SCENE` does a user's scene.
"""

from melp_warp.study.tradeoff.cases import CASES, KNOBS, MEANING, STANDARD, Case, changes_of
from melp_warp.study.tradeoff.records import (
    EXACT,
    NOISE,
    SOLVED,
    Record,
    behind,
    front,
    order,
    ran,
    with_as_good_a_picture,
)
from melp_warp.study.tradeoff.studies import (
    designed,
    field_error,
    measure,
    one_at_a_time,
    print_record,
    scene_study,
    study,
)
from melp_warp.study.tradeoff.tables import plot, save, table

__all__ = [
    "CASES",
    "EXACT",
    "KNOBS",
    "MEANING",
    "NOISE",
    "SOLVED",
    "STANDARD",
    "Case",
    "Record",
    "behind",
    "changes_of",
    "designed",
    "field_error",
    "front",
    "measure",
    "one_at_a_time",
    "order",
    "plot",
    "print_record",
    "ran",
    "save",
    "scene_study",
    "study",
    "table",
    "with_as_good_a_picture",
]
