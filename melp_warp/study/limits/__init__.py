"""The extremes: runs at the edges of what can be asked for, each with a verdict.

A case is a run that ends in one of four ways, see `OUTCOMES`; anything else (a number that is not finite, liquid that
is lost, another exception) is an error of the program. The tests run the quick ones, `tools/limits.py` all of them, and
writes docs/limits.md. `random_scene` draws scenes from the whole range of every key.
"""

from melp_warp.study.limits.judging import (
    ACCURATE,
    OUTCOMES,
    REFUSED,
    STOPPED,
    WRONG,
    Case,
    Verdict,
    check_sound,
    judge,
)
from melp_warp.study.limits.matrix import MATRIX
from melp_warp.study.limits.random_scenes import random_scene, run_random
from melp_warp.study.limits.scenes import dumbbell, meeting, spiky, stray

__all__ = [
    "ACCURATE",
    "MATRIX",
    "OUTCOMES",
    "REFUSED",
    "STOPPED",
    "WRONG",
    "Case",
    "Verdict",
    "check_sound",
    "dumbbell",
    "judge",
    "meeting",
    "random_scene",
    "run_random",
    "spiky",
    "stray",
]
