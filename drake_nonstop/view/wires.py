"""The signals of a drawing: their labels, and the routes of their wires over a grid."""

import heapq
import math
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

UNIT = 10  # px between neighbouring lanes; lengths are in units unless they say px
SPARE_COLUMNS = 8  # between two boxes, beside the room for labels
SPARE_ROWS = 9
LABEL_SIZE = 12  # px
LABEL_LIFT = 4  # px from the wire
LINE_HEIGHT = 1.1  # of the size of a font
_LABEL_CHARACTERS = 13  # in one line
_NARROW, _WIDE = set("fijlrt I"), set("mwMW")

# Costs of a wire's route, in units of length.
_BEND_COST, _CROSSING_COST, _BRANCH_COST = 5, 9, 2
_PASSES = 3

Node = tuple[int, int]
_Start = tuple[int, int]  # cost and state
_STEPS: tuple[Node, ...] = ((-1, 0), (0, -1), (0, 1), (1, 0))
_TURNS = [[turn for turn in range(4) if turn != 3 - step] for step in range(4)]  # none back
_ACROSS, _DOWN = 1, 2  # directions of wires
_CROSSED = (_DOWN, _ACROSS, _ACROSS, _DOWN)  # by each step


@dataclass
class Signal:
    """An output port and the wires that leave it, by name "block.port -> block.port"."""

    name: str  # "block.port"
    flow: int
    source: Node = (0, 0)
    sinks: dict[str, Node] = field(default_factory=dict)
    paths: dict[str, list[Node]] = field(default_factory=dict)  # each from the trunk to its sink

    @cached_property
    def lines(self) -> list[str]:
        """The label, in lines of about the same length."""
        words = self.name.partition(".")[2].replace("_", " ")
        count = len(textwrap.wrap(words, _LABEL_CHARACTERS))
        width = next(w for w in range(1, 99) if len(textwrap.wrap(words, w)) <= count)
        return textwrap.wrap(words, width, break_long_words=False)

    @property
    def label_width(self) -> int:
        """Lanes along the wire."""
        return math.ceil((max(text_width(line, LABEL_SIZE) for line in self.lines) + 8) / UNIT)

    @property
    def label_height(self) -> int:
        """Lanes above the wire."""
        lines_above = len(self.lines) - 1
        return int((LABEL_LIFT + (0.75 + lines_above * LINE_HEIGHT) * LABEL_SIZE + 3) / UNIT)

    @property
    def stem(self) -> list[Node]:
        """The start of the wires, straight below the label."""
        x, y = self.source
        return [(x + self.flow * i, y) for i in range(self.label_width + 1)]

    @property
    def label_nodes(self) -> list[Node]:
        """The nodes that the label covers."""
        heights = range(1, self.label_height + 1)
        return [(x, y - height) for x, y in self.stem[1:-1] for height in heights]


def text_width(text: str, size: float) -> float:
    """The approximate width of a text in px."""
    widths = [0.3 if c in _NARROW else 0.85 if c in _WIDE else 0.58 for c in text]
    return size * sum(widths)


def route_all(signals: Sequence[Signal], blocked: set[Node], reserved: dict[Node, str]) -> bool:
    """Routes the wires of all signals, short ones first, in several passes.

    A pass after the first routes each signal around the routes of all others.

    Args:
        signals: which are given their paths.
        blocked: nodes of boxes and labels.
        reserved: nodes that only the signal of that name may use.

    Returns:
        False if a wire has no route.
    """

    def extent(signal: Signal) -> int:
        xs, ys = zip(signal.source, *signal.sinks.values(), strict=True)
        return max(xs) - min(xs) + max(ys) - min(ys)

    router = _Router(signals, blocked, reserved)
    ordered = sorted(signals, key=extent)
    return all(router.route(signal) for _ in range(_PASSES) for signal in ordered)


class _Router:
    """Routes wires over the grid: around boxes and labels, across other wires.

    A node is numbered by column, then row; a state, that is a node and the step to it, is four
    times that plus the step's index in `_STEPS`.
    """

    def __init__(self, signals: Sequence[Signal], blocked: set[Node], reserved: dict[Node, str]):
        self._signals = signals
        xs, ys = zip(*blocked, *reserved, strict=True)
        self._left, self._top = min(xs) - SPARE_COLUMNS - 1, min(ys) - SPARE_ROWS - 1
        self._width = max(xs) + SPARE_COLUMNS + 1 - self._left
        self._height = max(ys) + SPARE_ROWS + 1 - self._top
        self._moves = [dx * self._height + dy for dx, dy in _STEPS]
        self._blocked = {self._number(node) for node in blocked}
        self._reserved = {self._number(node): name for node, name in reserved.items()}
        free = np.zeros((self._width, self._height), np.uint8)
        free[1:-1, 1:-1] = 1  # so that no step leaves the grid
        self._free = bytearray(free)  # of each node, whether any signal may use it
        for number in (*self._blocked, *self._reserved):
            self._free[number] = 0

    def _number(self, node: Node) -> int:
        return (node[0] - self._left) * self._height + node[1] - self._top

    def _node(self, number: int) -> Node:
        return number // self._height + self._left, number % self._height + self._top

    def route(self, signal: Signal) -> bool:
        """Routes all wires of the signal again, the cheapest first; False if one has no route."""
        signal.paths = {}
        taken = self._directions()
        free = self._free.copy()
        for number, name in self._reserved.items():
            free[number] = name == signal.name
        stem = [self._number(node) for node in signal.stem]
        starts = [(0, 4 * stem[-1] + _STEPS.index((signal.flow, 0)))]
        goals = {self._number(sink): wire for wire, sink in signal.sinks.items()}
        while goals:
            path = self._cheapest_path(starts, goals, free, taken)
            if not path:
                return False
            if not signal.paths:
                path = stem[:-1] + path
                starts = []
            signal.paths[goals.pop(path[-1])] = [self._node(number) for number in path]
            branchable = {number for number in path if not taken[number]} - self._blocked
            branchable -= set(stem[:-1])
            starts += [(_BRANCH_COST, 4 * node + step) for node in branchable for step in range(4)]
        return True

    def _directions(self) -> bytearray:
        """Of each node the directions of the wires there, added; 0: there is none."""
        taken = bytearray(len(self._free))
        for path in (path for signal in self._signals for path in signal.paths.values()):
            for a, b in pairwise(path):
                direction = _ACROSS if a[1] == b[1] else _DOWN
                taken[self._number(a)] |= direction
                taken[self._number(b)] |= direction
        return taken

    def _cheapest_path(
        self, starts: list[_Start], goals: Collection[int], free: bytearray, taken: bytearray
    ) -> list[int]:
        """The cheapest path by the A* algorithm; empty if there is none."""
        distances, moves = self._distances(goals), self._moves
        queue = [(cost + distances[state // 4], cost, state) for cost, state in starts]
        heapq.heapify(queue)
        costs = {state: cost for cost, state in starts}
        came_from: dict[int, int] = {}
        while queue:
            _, cost, state = heapq.heappop(queue)
            node, step = state >> 2, state & 3
            if node in goals:
                path = [node]
                while state in came_from:
                    state = came_from[state]
                    path.append(state // 4)
                return path[::-1]
            if cost > costs[state]:
                continue
            for turn in (step,) if taken[node] else _TURNS[step]:  # no turns on another wire
                onto = node + moves[turn]
                wires = taken[onto]
                if not free[onto] or (wires and wires != _CROSSED[turn]):
                    continue
                crossing = _CROSSING_COST if wires else 0
                longer = cost + 1 + crossing + (0 if turn == step else _BEND_COST)
                next_state = 4 * onto + turn
                if longer < costs.get(next_state, math.inf):
                    costs[next_state] = longer
                    came_from[next_state] = state
                    heapq.heappush(queue, (longer + distances[onto], longer, next_state))
        return []

    def _distances(self, goals: Collection[int]) -> list[int]:
        """Steps from each node to the nearest of the goals."""
        x, y = np.divmod(np.array([*goals]), self._height)
        across = abs(np.arange(self._width)[:, None] - x)
        down = abs(np.arange(self._height)[:, None] - y)
        return (across[:, None] + down).min(axis=2).ravel().tolist()
