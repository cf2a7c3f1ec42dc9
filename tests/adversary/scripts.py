"""Scripts as users write them: without a guard, from the standard input, in threads, in forks.

What a script calls comes to its end, or is refused with a ScenarioError that says why; a study's
journal does not keep runs that only failed because the script could not be imported.
"""

from pathlib import Path

import numpy as np

from adversary.commands import Command, last_frame
from adversary.processes import slowness
from adversary.verdicts import (
    EXIT_CODE,
    HANG,
    LEFTOVER,
    LOST_WORK,
    REFUSED,
    TRACEBACK,
    Case,
    Verdict,
    judge_sentence,
)

_IMPORTS = "import warnings\nfrom drake_nonstop import *\n"
_SCENARIO = "scenario = load_scenario('line', ['simulation_duration=0.02'])\n"
_WORK = {
    "sweep": "print(study(scenario, {'system.load_mass': [0.9, 1.0, 1.1]}, folder='out').table)\n",
    "ablate": "rows = ablate(scenario, {'a': ['phase=PaperPhase']}, 'out', replay=False)\n"
    "print(rows)\n",
    "simulate": "write_results(simulate(scenario), 'out', figures=False, replay=False)\n",
}
_FORMS = {
    "plain": "{body}",
    "guarded": 'if __name__ == "__main__":\n{indented}',
    "function": "def main():\n{indented}\n\nmain()\n",
    "thread": "import threading\ndef main():\n{indented}\n\n"
    "thread = threading.Thread(target=main)\nthread.start()\nthread.join()\n",
    "twice": "{body}{body}",
    "fork": "import os, sys\n{body}sys.stdout.flush()\nchild = os.fork()\nif child == 0:\n"
    "    os._exit(0)\nos.waitpid(child, 0)\n",
    "no signals": "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n{body}",
    "start method": "import multiprocessing\nmultiprocessing.set_start_method('{method}')\n{body}",
    "pool": "import multiprocessing\ndef work(k):\n{indented}\n\n"
    'if __name__ == "__main__":\n    with multiprocessing.Pool(1) as pool:\n'
    "        pool.map(work, [1])\n",
    "broken at the end": "{body}raise SystemExit(0)\n",
    "other folder": "import os\nos.makedirs('below')\nos.chdir('below')\n{body}os.chdir('..')\n",
}


def draw(rng: np.random.Generator) -> Case:
    work, form = str(rng.choice(list(_WORK))), str(rng.choice(list(_FORMS)))
    how = str(rng.choice(["a file", "a file", "a file of an odd name", "-c", "the standard input"]))
    body = _SCENARIO + _WORK[work]
    text = _IMPORTS + _FORMS[form].format(
        body=body,
        indented="".join(f"    {line}\n" for line in body.splitlines()),
        method=rng.choice(["fork", "spawn", "forkserver"]),
    )
    return Case(
        text=f"{work}, {form}, from {how}:\n{text}",
        attempt=lambda folder: _attempt(folder, text, work, how),
        limit=100,
    )


def _attempt(folder: Path, text: str, work: str, how: str) -> Verdict:
    name = "a b-é.py" if "odd" in how else "mine.py"
    (folder / name).write_text(text)
    arguments, script = ([], text) if how == "-c" else ([name], "")
    if how == "the standard input":
        arguments = ["-"]
    command = Command(
        arguments=[],
        folder=folder,
        is_fresh=True,
        script=script,
        python=arguments,
        stdin=name if how == "the standard input" else "",
    )
    verdict = Verdict()
    if not command.wait(60 * slowness()):
        verdict.add(HANG, "more than 60 s")
        command.kill()
        return verdict
    error, made = command.error, [*folder.rglob("out")]
    found = [line for line in error.splitlines() if "ScenarioError: " in line]
    journals = [path for folder in made for path in folder.glob("journal.jsonl")]
    if any("process died" in path.read_text() for path in journals):
        verdict.add(LOST_WORK, f"{work}: the journal keeps that processes could not start")
    if found:
        verdict.ending = REFUSED
        judge_sentence(verdict, found[-1].partition("ScenarioError: ")[2], has_own_code=True)
    elif command.code != 0:
        verdict.add(EXIT_CODE if not error else TRACEBACK, f"{command.code}: {last_frame(error)}")
    elif "Traceback" in error:
        verdict.add(TRACEBACK, f"printed, though it went on: {last_frame(error)}")
    results = {"sweep": "runs.csv", "ablate": "index.html", "simulate": "signals.npz"}[work]
    if command.code == 0 and not found and not [*folder.rglob(results)]:
        verdict.add(LOST_WORK, f"{work}: exit code 0, but there is no {results}")
    if command.code == 0 and "failed" in command.out:
        verdict.add(LOST_WORK, f"{work}: exit code 0, but runs failed: {command.out[:200]}")
    for process in command.leftovers():
        verdict.add(LEFTOVER, f"process {process}")
    return verdict
