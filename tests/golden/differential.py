"""Do two states of the program propose the same designs and stop at the same simulations?

    PYTHONPATH=tests python -m golden.differential FORMER [--seeds 20]

FORMER is a checkout of the former state. Each seed is three campaigns: in batches, asynchronous, and of a rare failure
with a stop rule (margins.toml, asynchronous.toml, rare.toml). Their designs, in hexadecimal digits, and their outcomes
are compared.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path


def campaigns_of(checkout: Path, seed: int) -> dict[str, list[object]]:
    """The designs and outcomes of the campaigns of a seed, by a state of the program."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(Path(__file__).parent / "files" / "seed.py"), str(seed)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, list[object]] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Compare the two states seed by seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("former", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    here, same, total = Path(__file__).resolve().parents[2], 0, 0
    for seed in range(arguments.seeds):
        former, now = (campaigns_of(checkout, seed) for checkout in (arguments.former, here))
        for name, one in former.items():
            total += 1
            same += one == now[name]
            if one != now[name]:
                print(f"seed {seed}, {name}: {len(one[1])} simulations before, {len(now[name][1])} now")  # noqa: T201
    print(f"{same} of {total} campaigns are the same")  # noqa: T201


if __name__ == "__main__":
    main()
