# SPDX-License-Identifier: GPL-3.0-or-later
"""Seconds of the networks without onnxruntime, beside those with it.

    python -m benchmarks.cost.built_in [--points 4096] [--rounds 20]

Evaluates each of the shipped files in turn by both, on one thread, and prints the least seconds of each, their ratio,
and the largest difference of the results over the largest result.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
import onnxruntime

from inference.models.weights_file import WEIGHTS
from inference.network.provider import _session
from inference.onnx.session import Session
from training import rpnn

from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.built_in"


def inputs(session: onnxruntime.InferenceSession, points: int) -> dict[str, np.ndarray]:
    """Random values; an eighth as many views as points."""
    random, sizes, made = np.random.default_rng(0), {"A": 3, "C": 3, "N": points, "V": points // 8}, {}
    for asked in session.get_inputs():
        shape = [sizes.get(size, size) for size in asked.shape]
        whole = random.integers(0, sizes["V"], shape, dtype=np.int32)
        made[asked.name] = whole if "int32" in asked.type else random.random(shape, np.float32)
    return made


def seconds(run: Callable[[], object]) -> float:
    start = time.thread_time()
    run()
    return time.thread_time() - start


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--rounds", type=int, default=20)
    arguments = parser.parse_args(options)
    # Renders free arrays as large as these before they predict; then the allocator keeps memory for the next.
    for megabytes in (4, 8, 16, 30):
        np.ones((megabytes, 1 << 18), np.float32)
    print("| network | milliseconds with onnxruntime | built-in | ratio | difference |\n|---|---|---|---|---|")
    for path in [*sorted(WEIGHTS.rglob("*.onnx")), *rpnn.WEIGHTS.glob("*.onnx")]:
        content = path.read_bytes()
        theirs, ours = _session(onnxruntime, content, "CPU"), Session(content)
        given, names = inputs(theirs, arguments.points), [output.name for output in theirs.get_outputs()]
        (expected,), (found,) = theirs.run(names, given), ours.run(names, given)
        difference = np.abs(found - expected).max() / np.abs(expected).max()
        rounds = [
            [seconds(lambda one=one: one.run(names, given)) for one in (theirs, ours)] for _ in range(arguments.rounds)
        ]
        least = np.min(rounds, axis=0)
        name = path.stem if path.parent in (WEIGHTS, rpnn.WEIGHTS) else f"{path.parent.name}/{path.stem}"
        print(
            f"| {name} | {1e3 * least[0]:.1f} | {1e3 * least[1]:.1f} | {least[1] / least[0]:.2f} | {difference:.0e} |"
        )
    print(f"\n{made_by(PROGRAM, options)}")


if __name__ == "__main__":
    main()
