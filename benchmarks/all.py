# SPDX-License-Identifier: GPL-3.0-or-later
"""Every figure in docs and README anew, one command after the other, in a night or more.

    python -m benchmarks.all [--list] [--only WORDS] [--eevee ARGUMENTS]

What is done for the present code and weights, by this version of Python, is skipped, so that a run that was stopped
continues; a command that fails is told and the rest go on. What commands print is kept in build/all. Run it once more
with Blender 5.2's module for that version's rows. A table that a command prints goes to its file in docs/tables, or
between the marks <!-- the command --> and <!-- end --> of a page. EEVEE needs a graphics driver, and its viewport a
display: --eevee "--window --blender COMMAND" names a Blender that has them. Screenshots need one in the variable
MRPNN_WINDOWS, as tests of windows do. --list says which tables in docs are of other weights or older code, and runs
nothing.
"""

import argparse
import hashlib
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from .support.extension import ROOT
from .support.pages import replace, with_table, write_tables
from .support.provenance import made_by

#: What decides a figure; pages are not among it.
CODE = ("inference", "evaluation", "mrpnn_addon", "operators", "panels", "training", "benchmarks", "gallery")
RENDERER = ("inference", "mrpnn_addon")
SYSTEMS = "--models mrpnn mrpnn-paper mrpnn-narrow mrpnn-wide rpnn"
EEVEE = "benchmarks.cycles.baked_eevee"
SKY = "benchmarks.cost.sky --counts 1 10 100 1000 10000 --clouds 5 --whole"
TURNED_SKY = "benchmarks.cost.sky --counts 1 10 40 --clouds 5 --turned --whole"
MANY_LAMPS = (
    "benchmarks.cost.lamps --rounds 5 --sizes 64x64 --only 'four suns' 'four point lights' 'twelve spots of a stage'"
    " 'thirty lamps of a street' 'thirty point lights inside' 'thirty-six panels of a ceiling'"
)
LAMPS = (
    "benchmarks.cost.lamps --rounds 3 --sizes 64x64 256x256 1920x1080 --only 'a point light' 'a spot light'"
    " 'an area light' 'a point light inside'"
)
BAKED_ANGLES = "benchmarks.fidelity.baked_directions smoke-100-front-g0.857 cumulus-100-back-g0.857 --turn 20 30 60"
#: In the order in which they run: what is short, and then what takes hours.
COMMANDS = (
    "benchmarks.demo --figures docs/tables/readme.csv",
    "benchmarks.cost.imported_smoke --figures docs/tables/readme.csv",
    "benchmarks.cost.frame --table",
    "benchmarks.cost.speed",
    "benchmarks.cost.scaling",
    "benchmarks.cost.built_in",
    "benchmarks.cost.environments --rounds 3",
    MANY_LAMPS,
    LAMPS,
    "benchmarks.cost.sparse",
    SKY,
    TURNED_SKY,
    "benchmarks.cost.puffs",
    "benchmarks.cost.bakes",
    "benchmarks.cycles.live_light",
    "benchmarks.cycles.baked_frames",
    "gallery --compare 320 180 --reference 120 --docs",
    "tests.windows.screenshots",
    "benchmarks.cost.viewport",
    "benchmarks.cycles.film",
    "benchmarks.cycles.blur",
    "benchmarks.cycles.skies",
    "benchmarks.cycles.settings",
    "benchmarks.cycles.baked_speed",
    "benchmarks.cycles.baked_speed --size 512",
    "benchmarks.fidelity.lamps --seeds 6 --photons 3000000",
    "benchmarks.fidelity.colours",
    "benchmarks.fidelity.colours --emission --paths 256",
    "benchmarks.fidelity.environments --predicted --seeds 1003000 1600200",
    "benchmarks.fidelity.baked_directions",
    "benchmarks.six_way.errors",
    "benchmarks.six_way.cost",
    "benchmarks.six_way.picture",
    BAKED_ANGLES,
    "benchmarks.fidelity.baked_directions cumulus-100-side-g0.857 --light sky parallel lamp",
    "benchmarks.cycles.baked_picture --samples 2 --most 64",
    "benchmarks.cycles.baked_film --size 32 --frames 12",
    "benchmarks.cycles.baked_surroundings --size 40 --samples 512",
    "benchmarks.cycles.baked_light",
    "benchmarks.cycles.baked_room",
    EEVEE,
    f"benchmarks.fidelity --out build/fidelity --docs --views independent {SYSTEMS}",
    f"benchmarks.fidelity --out build/retraced --docs --views retraced --samples 4096 {SYSTEMS}",
    "benchmarks.stability",
    "benchmarks.stability.soak",
    "benchmarks.cycles.scenes --samples 96",
    "benchmarks.fidelity --out build/real --docs --views real --models mrpnn --size 32 --samples 256"
    " --depth-samples 32",
    "benchmarks.fidelity --out build/held --docs --views procedural --match g0.857-albedo1"
    " --models mrpnn mrpnn-paper rpnn --size 48 --samples 512",
    "benchmarks.fidelity.calibration --docs",
    "training.data.targets --out data/uncertainty --volumes 2000-2023 --points 192 --paths 1024",
    "training.data.targets --out data/uncertainty --volumes 602000-602013 --points 192 --paths 1024",
    "training.data.targets --out data/uncertainty --volumes 502000-502002 --points 192 --paths 1024",
    # Trained again for its figures; the weights that are shipped stay.
    "training.train_uncertainty --data data/uncertainty --out build/uncertainty/mrpnn.onnx",
    "training.data.targets --out data/test --volumes 1000000-1000039 --points 256 --paths 1024",
    "training.evaluate --held data/test --checkpoint inference/weights/mrpnn.onnx",
    "benchmarks.error_vs_time.real_sizes",
    "benchmarks.error_vs_time",
)
#: What is measured with Cycles 5 too, or only there.
COMMANDS_5 = (
    "benchmarks.cycles.baked_ways",
    "benchmarks.cycles.settings",
    "benchmarks.error_vs_time.real_sizes",
    "benchmarks.error_vs_time",
)
#: What prints a table: the name of its CSV file in docs/tables.
TABLES = {
    "benchmarks.cost.frame --table": "speed-frame",
    SKY: "speed-sky",
    TURNED_SKY: "speed-sky-turned",
    "benchmarks.cost.puffs": "speed-puffs",
    "training.evaluate --held data/test --checkpoint inference/weights/mrpnn.onnx": "weights-points",
    "benchmarks.cost.speed": "speed-stages",
    "benchmarks.cost.environments --rounds 3": "speed-environments",
    MANY_LAMPS: "speed-many-lamps",
    LAMPS: "speed-lamps",
    "benchmarks.cost.viewport": "speed-viewport",
    "benchmarks.cost.bakes": "baked-cost",
    "benchmarks.cycles.live_light": "live-light",
    "benchmarks.cycles.baked_speed": "baked-speed",
    "benchmarks.cycles.baked_speed --size 512": "baked-speed-512",
    "benchmarks.fidelity.lamps --seeds 6 --photons 3000000": "accuracy-lamps",
    "benchmarks.fidelity.colours": "accuracy-colours",
    "benchmarks.fidelity.colours --emission --paths 256": "accuracy-emission",
    "benchmarks.fidelity.environments --predicted --seeds 1003000 1600200": "accuracy-worlds",
    "benchmarks.fidelity.baked_directions": "baked-directions",
    "benchmarks.cycles.blur": "blur",
    "benchmarks.cycles.skies": "time-skies",
    "benchmarks.six_way.errors": "six-way",
    "benchmarks.six_way.cost": "six-way-cost",
    BAKED_ANGLES: "baked-angles",
    "benchmarks.fidelity.baked_directions cumulus-100-side-g0.857 --light sky parallel lamp": "baked-lights",
    "benchmarks.cycles.baked_film --size 32 --frames 12": "baked-flicker",
    "benchmarks.cycles.baked_surroundings --size 40 --samples 512": "baked-surroundings",
    "benchmarks.cycles.baked_light": "baked-views",
    EEVEE: "baked-eevee",
    "benchmarks.cycles.baked_ways": "baked-ways",
}
PROGRAM, COMMIT = r"python\S*\s+-m\s+((?:benchmarks|training|gallery)(?:[\w.]*\w)?)|run\.py (demo)", "[0-9a-f]{7,12}"


class Stamp(NamedTuple):
    """What made a table: its page, the command named there or last before, commits, first digits of checksums."""

    page: Path
    program: str
    commits: list[str]
    checksums: list[str]


def stamps() -> Iterator[Stamp]:
    """Of the tables in README and docs, but for the history of what was."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "docs").rglob("*.csv"))]
    for page in pages:
        program, texts = "", re.split(r"\n\s*\n|\n- |\n# ", "" if page.name == "history.md" else page.read_text())
        for text, after in zip(texts, [*texts[1:], ""]):
            # Where the sentence ends with a colon, the command follows.
            named = re.findall(PROGRAM, text + (after if text.endswith(":") else ""))
            program = f"benchmarks.{named[-1][1]}" if named and named[-1][1] else named[-1][0] if named else program
            several = re.findall(rf"commits?\s+({COMMIT}(?:(?:, | and | to ){COMMIT})*)\b", text)
            commits = list(dict.fromkeys(re.findall(COMMIT, " ".join(several))))
            if commits:
                checksums = sorted(set(re.findall(r"\b[0-9a-f]{12}\b", text)) - set(commits))
                yield Stamp(page, program, commits, checksums)


def shipped() -> dict[str, str]:
    """First digits of each shipped network's checksum: its file."""
    files = sorted((ROOT / "inference" / "weights").rglob("*.onnx"))
    return {hashlib.sha256(file.read_bytes()).hexdigest()[:12]: file.stem for file in files}


def stale() -> Iterator[str]:
    """A line for each table of other weights or of an older renderer."""
    present = shipped()
    for stamp in stamps():
        other = [checksum for checksum in stamp.checksums if checksum not in present]
        reasons = [f"weights {', '.join(other)}"] if other else []
        for commit in stamp.commits:
            changes = _git("rev-list", "--count", f"{commit}..HEAD", "--", *RENDERER)
            reasons += [f"changes of the renderer since {commit}: {changes or 'unknown'}"] if changes != "0" else []
        if reasons:
            yield f"{stamp.page.relative_to(ROOT)}: {stamp.program}: {'; '.join(reasons)}"


def run(commands: Sequence[str], folder: Path, of_machine: Mapping[str, str] | None = None) -> int:
    """Run what is not done for the present code and weights; gives the number of commands that failed.

    of_machine: arguments that only this machine needs, by the command that they are added to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    state, version = [_git("log", "-1", "--format=%h", "--", *CODE), *shipped()], "{}.{}".format(*sys.version_info)
    file, failed = folder / "done.json", 0
    for command in commands:
        done = json.loads(file.read_text()) if file.exists() else {}
        if done.get(f"{command}, Python {version}") == state:
            print(f"done before: {command}", flush=True)
            continue
        print(f"running: {command}", flush=True)
        with open(folder / f"{re.sub('[^a-z0-9_]+', '-', command)[:80]}.log", "w+") as log:
            words = shlex.split(f"{command} {(of_machine or {}).get(command, '')}")
            status = subprocess.call([sys.executable, "-m", *words], cwd=ROOT, stdout=log, stderr=log)
            log.seek(0)
            printed = log.read()
        if status == 0:
            enter(command, printed, ROOT / "docs")
            replace(file, json.dumps(done | {f"{command}, Python {version}": state}, indent=1) + "\n")
        else:
            print(f"failed with status {status}; see {log.name}", flush=True)
            failed += 1
    return failed


def enter(command: str, printed: str, docs: Path) -> None:
    """Write a table that a command has printed, with the sentence on what made it.

    It goes into its file of TABLES, and between its marks on a page of docs, where there are such.
    """
    lines = printed.splitlines()
    table = "\n".join(line for line in lines if line.startswith("|"))
    program, *arguments = shlex.split(command)
    told = [line for line in lines if line.startswith("Weights ") and f"python -m {program}" in line]
    source = told[-1] if told else made_by(program, arguments)
    if table and command in TABLES:
        write_tables(TABLES[command], table, [source], docs / "tables")
    for page in docs.rglob("*.md"):
        text = page.read_text()
        if table and f"<!-- {command} -->" in text:
            replace(page, with_table(text, command, table, source))


def _git(*arguments: str) -> str:
    """What git says, "" where it fails."""
    return subprocess.run(["git", *arguments], cwd=ROOT, text=True, capture_output=True).stdout.strip()


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.all", description=__doc__.split("\n\n")[0])
    parser.add_argument("--list", action="store_true", help="tables of other weights or older code; run nothing")
    parser.add_argument("--only", default="", metavar="WORDS", help="commands that contain this")
    parser.add_argument("--eevee", default="", metavar="ARGUMENTS", help=f"more arguments of {EEVEE}")
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(stale()))
        return 0
    commands = COMMANDS_5 if sys.version_info >= (3, 13) else COMMANDS
    wanted = [command for command in commands if options.only in command]
    return min(run(wanted, ROOT / "build" / "all", {EEVEE: options.eevee}), 1)


if __name__ == "__main__":
    sys.exit(main())
