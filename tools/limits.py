"""Run the extremes of `melp_warp.study.limits` and random scenes, and write what came of them to docs/limits.md.

python tools/limits.py --write               all cases and 300 random scenes
python tools/limits.py --only thickness      the cases of one topic, shown only
"""

from __future__ import annotations

import argparse
import datetime
import platform
import sys
from collections import Counter
from pathlib import Path

import warp as wp

from melp_warp.study import limits
from melp_warp.tables import wrap_markdown

PAGE = Path(__file__).resolve().parents[1] / "docs" / "limits.md"
RANDOM = 300

MEANING = {
    limits.ACCURATE: "stable, and within the bounds",
    limits.WRONG: "stable, but off by what is said",
    limits.REFUSED: "refused when the scene is made, exit code 2",
    limits.STOPPED: "stopped with the stage named, the last good frame and a checkpoint kept, exit code 1",
}

NOTES = """\
## What is behind the rows

* **Pressure** is that of Young and Laplace, 4 sigma/R. A resting bubble meets it to 1e-5 with any number of E; one
  that wobbles (`giant_bubble`) is compared with the sphere of its mean radius, which says less. **Roundness** is the
  largest less the smallest distance of the E from their middle, relative. **Gas law** is p V = n R T. Bounds: 3 %, 1
  %, 1e-3; mass and surfactant 1e-5; ways 0.5 %; frequencies 2 %; volumes of foams 1e-3; energy may grow by 1 %.
* **A frame that leaps is done again.** Where a particle moves more than 0.3 of the film's radius in a step, relative
  to the film as a whole, the frame is done again in steps that are at most half as long, and neighbour lists that
  overflow get twice the room. The run stops where that would ask for steps in which the fastest wave crosses less
  than 0.3 spacings, when the step is not to blame, or for over 2,000 steps a frame. The scheme `explicit` is left to
  its user.
* **Solves are watched.** A solve that is given up above its tolerance is a notice of the run (docs/command-line.md);
  one with a relative residual above 0.5, or none that is finite, stops it. `max_iterations` follows the film by
  itself, 100 + sqrt(E) ln(2/tolerance): five times what conjugate gradients need for the surface Laplacian of an even
  film. With the air's added mass the residual is that of the sum of partial fractions, not that of the slowest of
  them, which is 10 times as large: the sum at 2,000 and 8,000 E is within 1.1e-4 of the same operator solved in
  float64. Films of 10,000 E and more need a tenth of the iterations, whatever their number (docs/method.md, "Large
  films").
* **Far from the origin** positions are measured from the film: float32 resolves 6e-5 m at 1 km. A bubble that flies
  takes its origin along. USD prims carry the place as a translation, checkpoints as `origin`.
* **An L that has lost the film** is put onto the nearest E, with its liquid; where over 1 % of the L are lost at once
  the step was too long.
* **Without surfactant an upright film empties**, as clean water does: its liquid falls freely, and the border behind
  the bottom rim collects it. The same happens at 100 g, where the drainage length is a quarter of the spacing. "Not
  where it falls": how far the collected share is from g t^2/2 over the height; 5 % is one row of E.
* **A film thicker than its E are apart stops the run**: nothing is thin about it. At 100 m/s liquid runs together in
  the corners of its frame a hundred times faster than surfactant can drive it apart.
* **A bubble inside another** is refused, as any overlap is: a region is what lies within one closed film, and the gas
  of the outer one would have to be the space between two.
* **Random scenes** draw a third of their keys from the whole range of each, log-uniform where it spans decades; three
  of four are made to go together (E enough for the support, tension left, ...). Each runs two frames and must keep
  every number finite, mass, surfactant and the gas law, or be refused or stopped.

## What falls short

* **A needle** of 600 E stops, with air, too: its tip, of 1.5 spacings, is not resolved. A squashed bubble in a vacuum
  goes through, by chance.
* **Hovering at 100 g and whirls of 100 m/s** tear a film that tension cannot hold (m v^2/R is 14 times 4 sigma/R);
  the program has no tearing, so it stops.
* **Bubbles thrown at each other** hold up to 2 m/s; at 20 m/s, where the inertia of the air that they take along is
  many times 4 sigma/R, they stop on contact. In a vacuum all of 16 runs from 2 to 3.5 m/s went through, and 13 of 16
  from 4 to 5.5 m/s: it is chance then. At a wall 1 m/s goes through and 18 m/s does not, since bubbles carry the
  air of their motion as a whole: up to 19 m/s did before.
* **E on one line stop** at support 3 and, since shifts are bounded by the film's size, at 4.
* **A dumbbell in a vacuum is chance:** of eight numbers of E from 600 to 2,000 seven go through at support 3 (1,000
  do not), six at support 4 (1,500 and 2,000 do not). In air all do.
* **Random scenes**: in seed 194, a foam whose films all burst at once into 160,000 drops, 0.4 % of the liquid is lost
  with its last L.
"""


def cell(text: str) -> str:
    """Text that a table can hold."""
    return " ".join(text.split()).replace("|", "\\|")


def run_cases(cases: list[limits.Case]) -> list[tuple[limits.Case, limits.Verdict]]:
    """Carry out the cases, saying how each ended."""
    found = []
    for case in cases:
        verdict = limits.judge(case)
        sign = " " if verdict.outcome == case.expected else "!"
        print(f"{sign} {case.topic}: {case.setting}: {verdict.outcome}, {verdict.seconds:.1f} s: {verdict.detail}")
        found.append((case, verdict))
    return found


def run_random(count: int) -> Counter:
    """Carry out random scenes; how often each outcome came."""
    outcomes = Counter()
    for seed in range(count):
        verdict = limits.run_random(seed)
        outcomes[verdict.outcome] += 1
        print(f"  seed {seed}: {verdict.outcome}, {verdict.seconds:.1f} s: {verdict.detail}")
    return outcomes


def page(found: list[tuple[limits.Case, limits.Verdict]], outcomes: Counter) -> str:
    """The text of docs/limits.md."""
    rows = [f"| {c.topic} | {cell(c.setting)} | {v.outcome} | {cell(v.detail)} |" for c, v in found]
    drawn = ", ".join(f"{outcomes[name]} {name}" for name in limits.OUTCOMES)
    return "\n".join(
        [
            "# Limits",
            "",
            "What happens at the edges. Made by `python tools/limits.py --write` on"
            f" {datetime.date.today():%Y-%m-%d} from real runs (Warp {wp.config.version}, {platform.machine()} CPU);"
            " the quick ones are in the default tests, the others run with `pytest -m slow`."
            " Bubbles are of radius 5 cm with 600 E and 4 L each in steps of 1/60 s where nothing else is said.",
            "",
            *(f"* **{name}**: {meaning}" for name, meaning in MEANING.items()),
            "",
            "| what | how far | outcome | off by, or the message |",
            "|---|---|---|---|",
            *rows,
            "",
            f"Of {outcomes.total()} random scenes: {drawn}; none went on with numbers that cannot be.",
            "",
            NOTES,
        ]
    )


def main(arguments: list[str] | None = None) -> int:
    """Entry point; 1 where a case did not end as it must."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    topics = list(dict.fromkeys(case.topic for case in limits.MATRIX))
    parser.add_argument("--only", nargs="+", metavar="TOPIC", choices=topics, help="these topics alone")
    parser.add_argument("--random", type=int, default=RANDOM, metavar="N", help=f"random scenes (default: {RANDOM})")
    parser.add_argument("--write", action="store_true", help="write docs/limits.md")
    options = parser.parse_args(arguments)
    if options.write and options.only:
        parser.error("--write wants every topic: leave --only out")
    found = run_cases([case for case in limits.MATRIX if case.topic in (options.only or topics)])
    outcomes = Counter() if options.only else run_random(options.random)
    if options.write:
        PAGE.write_text(wrap_markdown(page(found, outcomes)))
        print(f"wrote {PAGE}")
    missed = [f"{case.topic}: {case.setting}" for case, verdict in found if verdict.outcome != case.expected]
    if missed:
        print("not as expected: " + "; ".join(missed), file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
