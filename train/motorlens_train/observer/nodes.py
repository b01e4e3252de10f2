"""An observer written into an ONNX graph: its straight-line programs as nodes, its correction in a branch."""

from collections.abc import Sequence
from typing import Any, Protocol

from onnx import TensorProto, helper

from motorlens_train.observer.file import TIME, WINDOW, Observer
from motorlens_train.observer.program import Program

_OPERATORS = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "neg": "Neg", "sqrt": "Sqrt", "exp": "Exp", "log": "Log",
    "tanh": "Tanh", "sin": "Sin", "cos": "Cos", "abs": "Abs", "sign": "Sign", "pow": "Pow", "max": "Max", "min": "Min",
}  # fmt: skip


class Graph(Protocol):
    """What is written to; see `motorlens_train.export`."""

    nodes: list[Any]

    def add(self, operator: str, inputs: Sequence[str], output: str = "", **attributes: Any) -> str:
        """Append a node and return the name of its output."""

    def exact(self, values: Any) -> str:
        """A float64 constant."""

    def split(self, vector: str, sizes: Sequence[int]) -> list[str]:
        """Consecutive pieces of a vector."""


def observer_nodes(
    graph: Graph, observer: Observer, voltage: str, current: str, ambient: str, dt: str, state: str
) -> tuple[str, str]:
    """Write one sample of an observer; inputs are float64 `[1]`, the state `[S]`.

    Returns:
        names of its outputs `[M]` and of the next state `[S]`.
    """
    window = len(WINDOW)
    old = graph.split(state, [1] * observer.size)
    gathered = _write(graph, observer.accumulate, [voltage, current, ambient, dt, *old[:window]])
    full = graph.add("Squeeze", [graph.add("LessOrEqual", [graph.exact([observer.full_s]), gathered[TIME]])])
    kept = graph.add("Concat", [*gathered, *old[window:]], axis=0)
    # Both branches see the names of the outer graph; their own nodes are collected apart.
    outer, graph.nodes = graph.nodes, []
    corrected = _write(graph, observer.correct, [ambient, *gathered, *old[window:]])
    graph.add("Concat", corrected, f"{kept}_corrected", axis=0)
    then, graph.nodes = graph.nodes, []
    graph.add("Identity", [kept], f"{kept}_kept")
    otherwise, graph.nodes = graph.nodes, outer

    def branch(name: str, nodes: list[Any], result: str) -> Any:
        value = helper.make_tensor_value_info(result, TensorProto.DOUBLE, [observer.size])
        return helper.make_graph(nodes, name, [], [value])

    new = graph.add(
        "If", [full], f"{kept}_next",
        then_branch=branch("correct", then, f"{kept}_corrected"), else_branch=branch("wait", otherwise, f"{kept}_kept"),
    )  # fmt: skip
    outputs = _write(graph, observer.read, [ambient, *graph.split(new, [1] * observer.size)])
    return graph.add("Concat", outputs, axis=0), new


def _write(graph: Graph, program: Program, inputs: Sequence[str]) -> list[str]:
    """Nodes of a program; the names of its outputs."""
    registers = [*inputs, *(graph.exact([value]) for value in program.constants)]
    for name, arguments in program.steps:
        values = [registers[a] for a in arguments]
        if name == "le":
            registers.append(graph.add("Cast", [graph.add("LessOrEqual", values)], to=TensorProto.DOUBLE))
        elif name == "select":
            chosen = graph.add("Cast", values[:1], to=TensorProto.BOOL)
            registers.append(graph.add("Where", [chosen, *values[1:]]))
        else:
            registers.append(graph.add(_OPERATORS[name], values))
    return [registers[r] for r in program.outputs]
