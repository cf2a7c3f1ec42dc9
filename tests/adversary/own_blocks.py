"""Blocks of the user's own that raise, exit, hang, print, or change what all share.

The faulty block is a disturbance or an optimization layer, whose fault shows as its module is
imported, as it is made, or at some time of the run.
"""

import signal
import time
from pathlib import Path

import numpy as np

from adversary import earlier
from adversary.commands import COMPLETED_CODES, Command, ended, judge
from adversary.processes import slowness
from adversary.verdicts import (
    ACCEPTED,
    EXIT_CODE,
    HANG,
    LEFTOVER,
    LOST_WORK,
    MISREAD,
    SENTENCE,
    STOPPED,
    Case,
    Verdict,
)

_MODULE = """
import ctypes, gc, locale, logging, os, random, signal, sys, threading, time, warnings
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import LeafSystem


def fault(value=None):
    {fault}
    return value

{at_import}

@dataclass(kw_only=True)
class BadConfig:
    {fields}


class Bad(LeafSystem):
    def __init__(self, model, config):
        super().__init__()
        self.count = 0
        {at_start}
        self.DeclareVectorOutputPort("{signal}", {size}, self.calc)

    def calc(self, context, output):
        value = {value}
        if context.get_time() > 0.055:
            self.count += 1
            {at_run}
        output.SetFromVector(value)
"""
_BOXES = {
    "load_disturbance": ("disturbance_wrench", 6, "np.zeros(6)", "gust: float = 0.0"),
    "optimization_layer": ("parameters", 2, "np.array([2.0, 1.2])", "speed_bound: float = 0.2"),
}

# What the block does, and what has to come of it: "fails" (exit code not 0, one sentence, results
# up to there), "hangs" (Ctrl-C twice ends it), "flies" (as if nothing were).
_FAULTS: dict[str, str] = {
    "raise ValueError('broken')": "fails",
    "raise ValueError('two\\nlines')": "fails",
    "raise ValueError": "fails",
    "raise Exception('é 🛩 \\udcff')": "fails",
    "raise KeyboardInterrupt": "fails",
    "raise SystemExit": "fails",
    "raise GeneratorExit": "fails",
    "raise BaseException('base')": "fails",
    "raise MemoryError": "fails",
    "raise StopIteration": "fails",
    "raise type('Odd', (Exception,), {'__str__': lambda self: 1 / 0})()": "fails",
    "raise UnicodeDecodeError('utf-8', b'x', 0, 1, 'odd')": "fails",
    "raise BrokenPipeError('mine')": "fails",
    "raise OSError(28, 'No space left on device')": "fails",
    "from drake_nonstop import ScenarioError; raise ScenarioError('mine = 1: give 2')": "fails",
    "sys.exit(0)": "fails",
    "sys.exit(3)": "fails",
    "sys.exit('a text')": "fails",
    "exit()": "fails",
    "os._exit(0)": "dies",
    "os._exit(7)": "dies",
    "os.abort()": "dies",
    "os.kill(os.getpid(), signal.SIGKILL)": "dies",
    "os.kill(os.getpid(), signal.SIGSEGV)": "dies",
    "ctypes.string_at(0)": "dies",
    "value = np.full(np.shape(value), np.nan)": "fails late",
    "value = np.full(np.shape(value), np.inf)": "fails late",
    "value = np.full(np.shape(value), 1e300)": "fails late",
    "value = np.full(np.shape(value), -1e30)": "fails late",
    "value = None": "fails late",
    "value = 'text'": "fails late",
    "value = np.zeros(17)": "fails late",
    "value = np.zeros(0)": "fails late",
    "value = np.zeros((2, 3)) + 1j": "fails late",
    "while True: pass": "hangs",
    "time.sleep(1e6)": "hangs",
    "while True: time.sleep(0.01)": "hangs",
    "threading.Event().wait()": "hangs",
    "threading.Lock().acquire(); l = threading.Lock(); l.acquire(); l.acquire()": "hangs",
    "signal.pause()": "hangs",
    "sum(x for x in iter(int, 1))": "hangs",
    "np.linalg.matrix_power(np.eye(900), 2**60 - 1)": "hangs",
    "os.system('sleep 1000')": "hangs",
    "signal.signal(signal.SIGINT, signal.SIG_IGN)": "flies",
    "signal.signal(signal.SIGINT, signal.SIG_DFL)": "flies",
    "signal.alarm(3600)": "flies",
    "print('hello')": "flies",
    "print('x' * 100000)": "flies",
    "print('lost', file=sys.stderr)": "flies",
    "sys.stdout.write('\\udcff' if False else 'a')": "flies",
    "warnings.warn('mine')": "flies",
    "warnings.simplefilter('error')": "flies",
    "logging.basicConfig(level=0); logging.debug('mine')": "flies",
    "os.chdir('/')": "flies",
    "np.seterr(all='raise')": "flies",
    "np.random.seed(1); random.seed(1)": "flies",
    "os.umask(0o777)": "flies",
    "gc.disable()": "flies",
    "sys.setrecursionlimit(200)": "flies",
    "locale.setlocale(locale.LC_ALL, 'C')": "flies",
    "np.set_printoptions(threshold=1)": "flies",
    "os.environ.clear()": "flies",
    "sys.argv[:] = []": "flies",
    "sys.path[:] = []": "flies",
    "import matplotlib; matplotlib.rcParams['figure.dpi'] = 10; matplotlib.use('svg')": "flies",
    "sys.stdout = None": "any",
    "sys.stdout.close()": "any",
    "os.close(1)": "any",
    "threading.Thread(target=time.sleep, args=(2,)).start()": "flies",
    "threading.Thread(target=time.sleep, args=(1e6,), daemon=True).start()": "flies",
    "np.zeros(10**12)": "fails",
    "f = lambda: f(); f()": "fails",
    "1 / 0": "fails",
    "import no_such_module": "fails",
    "model.no_such": "fails",
    "del sys.modules['numpy']": "flies",
    "os.fork() or os._exit(0)": "flies",
    "sys.excepthook = None": "flies",
    "sys.settrace(lambda *a: None)": "flies",
}
_AT_RUN = "if self.count == 1: fault()", "value = fault(value)"  # once, or at every call
_STAGES = "at import", "in the constructor", "during the run", "during the run", "during the run"


def draw(rng: np.random.Generator) -> Case:
    fault = str(rng.choice(list(_FAULTS)))
    stage = str(rng.choice(_STAGES))
    box = str(rng.choice(list(_BOXES)))
    how = str(rng.choice(["run", "run", "run", "ablate", "sweep"]))
    expected = _FAULTS[fault]
    if stage != "during the run" and expected == "fails late":
        stage = "during the run"
    if expected == "hangs" and stage != "during the run":
        how = "run"
    text = f"{how} with {box}=bad.Bad, {stage}: {fault}"
    return Case(
        text=text,
        attempt=lambda folder: _attempt(folder, fault, stage, box, how, expected),
        limit=120,
    )


def _module(fault: str, stage: str, box: str) -> str:
    port, size, value, fields = _BOXES[box]
    lines = fault.replace("; ", "\n    ") if not fault.startswith(("while", "from x")) else fault
    return _MODULE.format(
        fault=lines,
        at_import="fault()" if stage == "at import" else "",
        fields=fields,
        at_start="fault()" if stage == "in the constructor" else "",
        signal=port,
        size=size,
        value=value,
        at_run="" if stage != "during the run" else _AT_RUN[_FAULTS[fault] == "fails late"],
    )


def _attempt(folder: Path, fault: str, stage: str, box: str, how: str, expected: str) -> Verdict:
    (folder / "bad.py").write_text(_module(fault, stage, box), errors="surrogatepass")
    (folder / "s.yaml").write_text(
        f"draws: {{system.load_mass: {{uniform: [0.9, 1.1]}}}}\nruns: 2\n"
        f"overrides: [simulation_duration=0.2, {box}=bad.Bad]\n"
    )
    brief = ["--no-replay", "--trust"]
    arguments = {
        "run": [
            "run",
            "line",
            "--no-figures",
            *brief,
            "--set",
            "simulation_duration=0.2",
            f"{box}=bad.Bad",
        ],
        "ablate": [
            "ablate",
            "line",
            *brief,
            "--set",
            "simulation_duration=0.2",
            "--swap",
            f"{box}=bad.Bad",
        ],
        "sweep": ["sweep", "line", "s.yaml", "--trust"],
    }[how]
    command = Command(arguments=[*arguments, "--out", "out"], folder=folder)
    if expected == "hangs":
        return _interrupted(command, how, stage)
    verdict = ended(command, 40, has_own_code=True)
    out, code = folder / "out", command.code
    said = f"{how}: exit code {code}"
    if expected == "dies" and how == "run":  # it takes the command with it
        verdict.faults = [
            f for f in verdict.faults if f[0] not in ("traceback", EXIT_CODE, SENTENCE)
        ]
        return verdict
    if "print" in fault or "stderr" in fault or "log" in fault or "sys.std" in fault:
        verdict.faults = [f for f in verdict.faults if "stray" not in f[1]]
    if expected in ("fails", "fails late", "dies") and how == "run" and code == 0:
        verdict.add(MISREAD, f"{said} though the block failed")
    is_diverged = expected == "fails late" and how != "run"
    if expected in ("fails", "dies") and how != "run" and code == 0 and not is_diverged:
        verdict.add(MISREAD, f"{said} though the block failed")
    if expected == "flies" and code not in COMPLETED_CODES:
        word = (command.error.strip().splitlines() or ["no word"])[-1]
        verdict.add(EXIT_CODE, f"{said}: {word}")
    if code == 130:
        verdict.add(EXIT_CODE, f"{said}: nobody interrupted it")
    if how == "run" and stage == "during the run" and expected in ("fails", "fails late", "flies"):
        if not (out / "signals.npz").is_file():
            verdict.add(LOST_WORK, f"{said}: 0.05 s were flown, but nothing is written")
        else:
            earlier.judge_results(verdict, out, 0.04)
    if how == "ablate" and verdict.ending == ACCEPTED and not (out / "index.html").is_file():
        verdict.add(LOST_WORK, f"{said}: no page")
    has_table = (out / "runs.csv").is_file()
    if how.startswith("sweep") and code in (0, 1) and stage == "during the run" and not has_table:
        verdict.add(LOST_WORK, f"{said}: no table")
    if out.exists():
        earlier.judge_tidiness(verdict, out)
    return verdict


def _interrupted(command: Command, how: str, stage: str) -> Verdict:
    """Two Ctrl-C end a block that never returns, within 2 s."""
    command.await_start()
    if command.wait((6.0 if how != "run" else 2.0) * min(3.0, slowness())):
        return judge(command, has_own_code=True)
    flown = command.flown
    command.send(signal.SIGINT)
    command.wait(0.5)
    command.send(signal.SIGINT)
    sent = time.monotonic()
    verdict = Verdict(ending=STOPPED)
    if not command.wait(2.0 * slowness()):
        gone = command.wait(10)
        state = f"ended after {time.monotonic() - sent:.1f} s" if gone else "does not end"
        verdict.add(HANG, f"{how}, {stage}: after two Ctrl-C it {state}")
        command.kill()
    else:
        verdict = judge(command, codes=[130], has_own_code=True)
        if command.code not in (130, -2):
            verdict.add(EXIT_CODE, f"{how}: {command.code} after two Ctrl-C")
        else:
            verdict.faults = [fault for fault in verdict.faults if fault[0] != EXIT_CODE]
    for process in command.leftovers():
        verdict.add(LEFTOVER, f"{how}: process {process}")
    out = command.folder / "out"
    if how == "run" and stage == "during the run" and not (out / "signals.npz").is_file():
        verdict.add(LOST_WORK, f"{how}: 0.05 s were flown ({flown:g}), but nothing is written")
    return verdict
