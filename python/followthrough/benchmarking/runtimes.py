# SPDX-License-Identifier: GPL-3.0-or-later
"""The published network in PyTorch and ONNX Runtime, each with the batching that is fastest on the scene and machine at hand.

A batching is how the free vertices are cut into chunks, and how a chunk's neighbours are laid out: rows of one length that are padded, or
vertices of equal degree together, without padding. Every one is checked against the native kernel before it is timed.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough import _core
from followthrough.benchmarking.methods import Method, MethodUnavailableError
from followthrough.benchmarking.scene import Scene
from followthrough.character import FloatArray
from followthrough.emulator import Emulator, Precision
from followthrough.emulator_weights import EmulatorWeights
from followthrough.solver import Solver, SolverState

Float32Array = NDArray[np.float32]
IntegerArray = NDArray[np.int64]

#: How far results may be from the native kernel's, as a share of the largest step that a vertex takes.
TOLERANCE = 1e-4
#: Free vertices a chunk that are tried, in this order; None: all in one.
CHUNKS = (128, 512, 2048, None)
#: Seconds after which no further batching is tried. What wins most often is tried first.
MOST_SECONDS = 5.0


@dataclass(frozen=True)
class Batching:
    """How free vertices are put together.

    Attributes
    ----------
    layout
        "padded" or "by degree", and how the runtime takes it.
    chunk
        Free vertices in one; None: all of one layout.
    """

    layout: str
    chunk: int | None

    def __str__(self) -> str:
        return f"{self.layout}, {'all at once' if self.chunk is None else f'{self.chunk} vertices at a time'}"


def chunks(neighbours: IntegerArray, batching: Batching) -> Iterator[tuple[IntegerArray, IntegerArray]]:
    """Rows (b,) of a table of neighbours (f, d) that -1 fills up, and their neighbours (b, e): -1 only where it is padded."""
    degrees = (neighbours >= 0).sum(axis=1)
    if batching.layout.startswith("by degree"):
        groups = [np.flatnonzero(degrees == degree) for degree in np.unique(degrees)]
    else:
        groups = [np.arange(len(neighbours))]
    for group in groups:
        size = batching.chunk or len(group)
        for start in range(0, len(group), size):
            rows = group[start : start + size]
            yield rows, np.ascontiguousarray(neighbours[rows, : degrees[rows].max()])


class RuntimeSolver(Solver, ABC):
    """The published network, run by something else than the core, on displacements in its own units.

    The state's arrays are positions of the last three frames, the newest first, then the reference of the last two, as `Emulator` has.
    """

    def __init__(self, patches: Any, batching: Batching) -> None:
        super().__init__(None)
        self.patches = patches
        self.batching = batching
        self.tried = ""
        self._dynamic: list[Float32Array] = []
        self._reference: list[Float32Array] = []

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return len(self.patches.rest_positions)

    @abstractmethod
    def changes(self, dynamic: Float32Array, reference: Float32Array) -> Float32Array:
        """u(t+1) - u(t) (f, 3) of u(t), u(t-1), u(t-2) (3, n, 3) and x(t+1), x(t), x(t-1) (3, n, 3)."""

    def reset(self, reference: ArrayLike) -> FloatArray:
        """Start over on the reference."""
        positions = np.asarray(reference, dtype=np.float64)
        self.resume(positions[None], positions[None])
        return positions

    def step(self, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """One frame further."""
        ahead = self.patches.displacements(np.asarray(reference))
        moved = ahead.copy()
        change = self.changes(np.stack(self._dynamic), np.stack([ahead, *self._reference]))
        moved[self.patches.centres] = self._dynamic[0][self.patches.centres] + change
        self._dynamic = [moved, *self._dynamic[:2]]
        self._reference = [ahead, self._reference[0]]
        return self._positions(moved)

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames that are known."""
        convert = self.patches.displacements
        self._dynamic = [convert(dynamic[max(len(dynamic) - k, 0)]) for k in (1, 2, 3)]
        self._reference = [convert(reference[max(len(reference) - k, 0)]) for k in (1, 2)]

    def state(self) -> SolverState:
        """Positions and references of the last frames."""
        return SolverState(tuple(self._positions(u) for u in (*self._dynamic, *self._reference)), 0)

    def restore(self, state: SolverState) -> None:
        """Go back to a state."""
        arrays = [self.patches.displacements(positions) for positions in state.arrays]
        self._dynamic, self._reference = arrays[:3], arrays[3:]

    def _positions(self, displacements: Float32Array) -> FloatArray:
        positions: FloatArray = self.patches.rest_positions + displacements.astype(np.float64) / self.patches.scale
        return positions


class PyTorchSolver(RuntimeSolver):
    """The network that training has, without gradients."""

    LAYOUTS = ("by degree", "padded")

    def __init__(self, patches: Any, weights: EmulatorWeights, batching: Batching) -> None:
        import torch

        from followthrough.training.network import PatchNetwork

        super().__init__(patches, batching)
        self._torch = torch
        self._network = PatchNetwork.from_weights(weights).eval()
        self._constrained = torch.from_numpy(patches.constrained)
        self._material = torch.from_numpy(patches.material)
        self._chunks = [
            (rows, torch.from_numpy(patches.centres[rows]), (torch.from_numpy(near),))
            for rows, near in chunks(patches.neighbours[0], batching)
        ]

    def changes(self, dynamic: Float32Array, reference: Float32Array) -> Float32Array:
        """As the base class says."""
        from followthrough.training.patches import PatchBatch

        torch = self._torch
        if torch.get_num_threads() != _core.threads():
            torch.set_num_threads(_core.threads())
        change = np.empty((len(self.patches.centres), 3), np.float32)
        u, x = torch.from_numpy(dynamic), torch.from_numpy(reference)
        with torch.inference_mode():
            for rows, centres, rings in self._chunks:
                batch = PatchBatch(u, x, self._constrained, self._material, centres, rings)
                change[rows] = self._network(batch).numpy()
        return change


class OnnxSolver(RuntimeSolver):
    """The same network as an ONNX graph; neighbours are gathered in the graph or before it."""

    LAYOUTS = ("by degree", "by degree, gathered before", "padded")

    def __init__(self, patches: Any, weights: EmulatorWeights, batching: Batching) -> None:
        import onnxruntime

        super().__init__(patches, batching)
        self._gathers = not batching.layout.endswith("gathered before")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = _core.threads()
        options.inter_op_num_threads = 1
        # Its threads must not spin while others are measured.
        options.add_session_config_entry("session.force_spinning_stop", "1")
        model = onnx_model(weights, gathers=self._gathers, padded=batching.layout == "padded")
        self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        self._chunks = list(chunks(patches.neighbours[0], batching))

    def changes(self, dynamic: Float32Array, reference: Float32Array) -> Float32Array:
        """As the base class says."""
        patches = self.patches
        count = len(patches.rest_positions)
        constrained = patches.constrained[:, None].astype(np.float32)
        seen = np.concatenate([constrained, *dynamic, *reference], axis=1)
        origin = reference[1][patches.centres]
        own = [frame[patches.centres] - origin for frame in (*dynamic, reference[0], reference[2])]
        centre = np.concatenate([*own, patches.material[patches.centres]], axis=1)
        origin = np.concatenate([np.zeros((len(origin), 1), np.float32), np.tile(origin, 6)], axis=1)
        change = np.empty((len(patches.centres), 3), np.float32)
        for rows, near in self._chunks:
            inputs = {"centre": centre[rows]}
            if self._gathers:
                inputs |= {"seen": seen, "origin": origin[rows, None], "neighbours": near % count}
                if self.batching.layout == "padded":
                    inputs["present"] = (near >= 0)[..., None].astype(np.float32)
            else:
                own_columns = np.broadcast_to(centre[rows, None], (*near.shape, centre.shape[1]))
                inputs["edges"] = np.concatenate([seen[near] - origin[rows, None], own_columns], axis=2)
            if self.batching.layout != "padded":
                inputs["degree"] = np.full((1, 1), near.shape[1], np.float32)
            (change[rows],) = self._session.run(None, inputs)
        return change


def onnx_model(weights: EmulatorWeights, *, gathers: bool, padded: bool) -> bytes:
    """The network of one ring as an ONNX model. The force MLP's last layer comes after the sum over neighbours."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes: list[Any] = []
    constants: list[Any] = []

    def constant(name: str, array: NDArray[Any]) -> str:
        constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def node(kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"{kind}_{len(nodes)}"
        nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def linear(name: str, k: int, values: str, degree: str | None = None) -> str:
        weight, bias = weights.layers(name)[k]
        product = node("MatMul", values, constant(f"{name}.{k}.weight", weight.T))
        if bias is None:
            return product
        term = constant(f"{name}.{k}.bias", bias)
        return node("Add", product, term if degree is None else node("Mul", degree, term))

    def perceptron(name: str, values: str, layers: int) -> str:
        for k in range(layers):
            values = linear(name, k, node("Tanh", values) if k else values)
        return values

    def depth(name: str) -> int:
        return len(weights.layers(name))

    inputs = [("centre", TensorProto.FLOAT, ["b", 18])]
    if gathers:
        inputs += [
            ("seen", TensorProto.FLOAT, ["n", 19]),
            ("origin", TensorProto.FLOAT, ["b", 1, 19]),
            ("neighbours", TensorProto.INT64, ["b", "d"]),
        ]
        moved = node("Sub", node("Gather", "seen", "neighbours"), "origin")
        shape = node("Concat", node("Shape", "neighbours"), constant("inputs", np.array([18])), axis=0)
        own = node("Expand", node("Unsqueeze", "centre", constant("middle", np.array([1]))), shape)
        edges = node("Concat", moved, own, axis=2)
    else:
        inputs.append(("edges", TensorProto.FLOAT, ["b", "d", 37]))
        edges = "edges"
    hidden = node("Tanh", perceptron("edge_mlp", edges, depth("edge_mlp") - 1))
    over_neighbours = constant("over neighbours", np.array([1]))
    if padded:
        inputs.append(("present", TensorProto.FLOAT, ["b", "d", 1]))
        hidden = node("Mul", hidden, "present")
        degree = node("ReduceSum", "present", over_neighbours, keepdims=0)
    else:
        inputs.append(("degree", TensorProto.FLOAT, [1, 1]))
        degree = "degree"
    summed = node("ReduceSum", hidden, over_neighbours, keepdims=0)
    force = linear("edge_mlp", depth("edge_mlp") - 1, summed, degree)
    joined = node("Concat", perceptron("point_mlp", "centre", depth("point_mlp")), force, axis=1)
    change = perceptron("instance_mlp", joined, depth("instance_mlp"))
    graph = helper.make_graph(
        nodes,
        "patch network",
        [helper.make_tensor_value_info(*described) for described in inputs],
        [helper.make_tensor_value_info(change, TensorProto.FLOAT, ["b", 3])],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    serialized: bytes = model.SerializeToString()
    return serialized


def batchings(kind: type[PyTorchSolver | OnnxSolver]) -> list[Batching]:
    """All that are tried for a runtime, in this order."""
    return [Batching(layout, chunk) for chunk in CHUNKS for layout in kind.LAYOUTS]


def native_solver(scene: Scene, weights: EmulatorWeights, precision: Precision = "float32") -> Emulator:
    """The core's own kernel. What it warns of concerns the motion, which random weights do not have.

    Raises
    ------
    ValueError
        Where this machine does not have the precision.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Emulator.of_sequence(scene.sequence, weights, edge_length=scene.edge, precision=precision)


def fastest(scene: Scene, weights: EmulatorWeights, kind: type[PyTorchSolver | OnnxSolver]) -> RuntimeSolver:
    """The runtime's solver with the batching that takes the least time here, with the core's number of threads.

    Where a step takes long, not all of them are tried (`MOST_SECONDS`).

    Raises
    ------
    ValueError
        Where a result is not the native kernel's.
    """
    from followthrough.training.patches import Scene as Patches

    patches = Patches.of_sequence(scene.sequence, weights.trained_on, edge_length=scene.edge)
    native = native_solver(scene, weights)
    dynamic, reference, ahead = _history(scene)
    native.resume(dynamic, reference)
    expected = native.step(ahead)
    step = np.abs(expected - dynamic[-1])[~scene.sequence.constrained].max()
    best: RuntimeSolver | None = None
    least = np.inf
    all_of_them = batchings(kind)
    tried = 0
    started = time.perf_counter()
    for batching in all_of_them:
        if tried and time.perf_counter() - started > MOST_SECONDS:
            break
        tried += 1
        solver = kind(patches, weights, batching)
        seconds: list[float] = []
        for _ in range(3):
            solver.resume(dynamic, reference)
            begun = time.perf_counter()
            found = solver.step(ahead)
            seconds.append(time.perf_counter() - begun)
            if sum(seconds) > 1.0 or min(seconds) > 1.5 * least:
                break
        off = np.abs(found - expected).max() / step
        if not off <= TOLERANCE:
            raise ValueError(
                f"{kind.__name__} ({batching}): found steps that differ by {off:.2g} of the largest one from the native kernel's, "
                f"expected at most {TOLERANCE:g} (this is a bug)"
            )
        if min(seconds) < least:
            best, least = solver, min(seconds)
    assert best is not None
    best.tried = str(tried) if tried == len(all_of_them) else f"the first {tried} of {len(all_of_them)}"
    return best


def _history(scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frames that are known (3, n, 3), with a motion of their own, their reference, and the reference ahead (n, 3)."""
    reference = scene.sequence.reference
    known = np.stack([reference[min(k, len(reference) - 1)] for k in range(3)])
    phase = np.arange(known.size).reshape(known.shape)
    dynamic = known + 0.05 * scene.edge * np.sin(phase) * ~scene.sequence.constrained[None, :, None]
    return dynamic, known, reference[min(3, len(reference) - 1)]


def runtime_methods(weights: EmulatorWeights) -> list[Method]:
    """PyTorch and ONNX Runtime on a network of the paper."""
    return [
        _method("pytorch", "PyTorch", ("torch",), PyTorchSolver, weights),
        _method("onnx-runtime", "ONNX Runtime", ("torch", "onnx", "onnxruntime"), OnnxSolver, weights),
    ]


def _method(
    name: str, title: str, needs: tuple[str, ...], kind: type[PyTorchSolver | OnnxSolver], weights: EmulatorWeights
) -> Method:
    def make(scene: Scene) -> Solver:
        missing = [package for package in needs if importlib.util.find_spec(package) is None]
        if missing:
            raise MethodUnavailableError(
                f"{' and '.join(missing)} not installed (pip install followthrough[benchmark])"
            )
        return fastest(scene, weights, kind)

    notes: Callable[[RuntimeSolver], list[str]] = lambda solver: [  # noqa: E731
        f"fastest of {solver.tried} batchings on {_core.threads()} thread{'s' if _core.threads() > 1 else ''}: {solver.batching}"
    ]
    return Method(name, f"the published network in {title}", make, notes=notes, same_bits=False, has_errors=False)
