"""Compare random hybrid systems with an independent integration (tests/exact/hybrid.py); store each result by seed.

python tests/benchmarks/systems_at_random.py                    2,000 systems: 200 structures with 10 draws each
python tests/benchmarks/systems_at_random.py --count 100 -o results.jsonl
python tests/benchmarks/systems_at_random.py --seed 17 --draw 3      one system, with its description
python tests/benchmarks/systems_at_random.py --kinds stop friction  structures with these events only

A result is a JSON line with seed, draw, kind and remark. A run that was interrupted continues: seeds whose results are
in the file are not computed again. The exit status is 1 if any result is WRONG.
"""

import json
import sys
import time
from argparse import ArgumentParser
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2]))
from exact.random_systems import draw, structure
from random_systems import compare

DRAWS, DURATION = 10, 20.0


def describe(described, p, start):
    """Print a system, so that its motion can be repeated by hand."""
    for name, expression in described.field.items():
        print(f"  {name}' = {expression}")
    for event in described.events:
        print(f"  {event}")
    print(f"  parameters {p}\n  start {start}")


def main(arguments):
    """Compute what is missing and print counts by kind; return the exit status."""
    single = arguments.seed is not None
    path = None if single else Path(arguments.output)
    results = [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []
    known = {(result["seed"], result["draw"]) for result in results}
    seeds = [arguments.seed] if single else range(arguments.first, arguments.first - (-arguments.count // DRAWS))
    for seed in seeds:
        draws = range(DRAWS) if arguments.draw is None else [arguments.draw]
        missing = [index for index in draws if (seed, index) not in known]
        if not missing:
            continue
        described, began = structure(seed, arguments.kinds and tuple(arguments.kinds)), time.perf_counter()
        for index in missing:
            p, start = draw(described, seed, index)
            if single:
                describe(described, p, start)
            try:
                kind, remark = compare(described, p, start, DURATION)
            except Exception as error:  # the run goes on to the other systems
                kind, remark = "WRONG", f"{type(error).__name__}: {error}"
            kinds = [event.name.split("_")[0] for event in described.events]
            results.append({"seed": seed, "draw": index, "events": kinds, "kind": kind, "remark": remark})
            if path:
                with path.open("a") as file:
                    file.write(json.dumps(results[-1]) + "\n")
            print(json.dumps(results[-1]), flush=True)
        print(f"seed {seed}: {time.perf_counter() - began:.0f} s", flush=True)
    print(dict(Counter(result["kind"] for result in results)))
    wrong = [f"{result['seed']}/{result['draw']}" for result in results if result["kind"] == "WRONG"]
    print(f"WRONG (seed/draw): {' '.join(wrong) or 'none'}")
    return int(bool(wrong))


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--draw", type=int)
    parser.add_argument("--kinds", nargs="+", choices=["stop", "jump", "switch", "friction"])
    parser.add_argument("-o", "--output", default="results.jsonl")
    sys.exit(main(parser.parse_args()))
