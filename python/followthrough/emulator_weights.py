# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights files of the emulator: the network's parameters under their names in PyTorch, and what they were trained on.

There are two kinds of network: the paper's, `patch`, and Newton steps that small networks guide, `guided-newton`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from followthrough import newton_weights
from followthrough.newton_weights import NewtonSchedule
from followthrough.npz_files import read_npz, write_npz

Float32Array = NDArray[np.float32]
#: Weight (outputs, inputs) and bias (outputs,) or None of a perceptron's layers; a tanh between every two.
Layers = list[tuple[Float32Array, Float32Array | None]]

#: The key that holds what is not a parameter, as JSON text.
METADATA_KEY = "followthrough"
FORMAT = 1
NETWORKS = ("patch", "guided-newton")
#: The weights that come with the package.
SHIPPED = Path(__file__).parent / "weights" / "emulator.npz"
PERCEPTRONS = ("point_mlp", "edge_mlp", "edge_mlp_2", "edge_mlp_3", "instance_mlp")


@dataclass(frozen=True)
class TrainedOn:
    """What a network means by its numbers, and how far its training reached. The defaults are [DE]'s.

    Attributes
    ----------
    edge_length, dt, density
        m, s and kg/m³ of its own units; scenes in others are mapped to them.
    poisson_ratio, compression_resistance
        Of the material that it learned.
    stiffness_range
        Smallest and largest dimensionless stiffness E dt² / (density edge_length²).
    """

    edge_length: float = 0.2
    dt: float = math.sqrt(0.001)
    density: float = 1000.0
    poisson_ratio: float = 0.45
    compression_resistance: float = 1e5
    stiffness_range: tuple[float, float] = (1.25, 125.0)

    def __post_init__(self) -> None:
        for name in ("edge_length", "dt", "density"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name}: found {getattr(self, name)}, expected a positive number")
        low, high = self.stiffness_range
        if not 0 < low <= high < math.inf:
            raise ValueError(f"stiffness_range: found {low:g} to {high:g}, expected two positive numbers in order")


@dataclass(frozen=True, eq=False)
class EmulatorWeights:
    """A network. Its architecture is whatever its parameters say; everything is checked when it is made.

    Attributes
    ----------
    parameters : dict of float32 arrays
        `point_mlp.0.weight` or `passes.0.1.weight` and so on (docs/command-line.md, "Weights files").
    trained_on
        Units and reach.
    manifest
        How it was made, for people: data, seed, configuration, scores.
    newton
        The passes, where this is a `guided-newton`; None: the paper's network.

    Raises
    ------
    ValueError
        Naming the parameter, what was found and what was expected.
    """

    parameters: Mapping[str, Float32Array]
    trained_on: TrainedOn = field(default_factory=TrainedOn)
    manifest: Mapping[str, Any] = field(default_factory=dict)
    newton: NewtonSchedule | None = None

    def __post_init__(self) -> None:
        dimensions = _dimensions_of if self.newton is None else newton_weights.dimensions_of
        parameters = {name: _checked(name, array, dimensions(name)) for name, array in self.parameters.items()}
        object.__setattr__(self, "parameters", parameters)
        if self.newton is None:
            self._require_patch_network()
        else:
            newton_weights.require_parameters(parameters, self.newton)

    def _require_patch_network(self) -> None:
        missing = [name for name in ("point_mlp", "edge_mlp", "instance_mlp") if not self.layers(name)]
        if missing:
            raise ValueError(
                f"found no {missing[0]}.0.weight, expected the parameters of point_mlp, edge_mlp and instance_mlp"
            )
        if self.layers("edge_mlp_3") and not self.layers("edge_mlp_2"):
            raise ValueError("edge_mlp_3: found without edge_mlp_2, expected the rings in order")
        known = {
            f"{name}.{2 * k}.{kind}" for name in PERCEPTRONS for k in range(len(self.layers(name))) for kind in KINDS
        }
        unknown = sorted(set(self.parameters) - known)
        if unknown:
            place = ", ".join(unknown[:5])
            raise ValueError(
                f"found {place}, expected only layers 0, 2, 4, ... of {', '.join(PERCEPTRONS)} without gaps"
            )
        inputs = self._require_chain("point_mlp", None)
        if inputs not in (18, 9):
            raise ValueError(
                f"point_mlp.0.weight: found {inputs} columns, expected 18, or 9 for a network that does not see the reference"
            )
        joined = self._outputs("point_mlp")
        for name in ("edge_mlp", "edge_mlp_2", "edge_mlp_3")[: self.rings]:
            self._require_chain(name, 37 if inputs == 18 else 19)
            joined += self._outputs(name)
        self._require_chain("instance_mlp", joined)
        if self._outputs("instance_mlp") != 3:
            raise ValueError(f"instance_mlp: found {self._outputs('instance_mlp')} outputs, expected 3")

    @property
    def network(self) -> str:
        """`patch` or `guided-newton`."""
        return "patch" if self.newton is None else "guided-newton"

    @property
    def rings(self) -> int:
        """How many edges away a vertex is seen: 1 to 3."""
        return 1 + bool(self.layers("edge_mlp_2")) + bool(self.layers("edge_mlp_3"))

    @property
    def sees_reference(self) -> bool:
        """Whether it sees where the reference is."""
        return self.parameters["point_mlp.0.weight"].shape[1] == 18

    @property
    def parameter_count(self) -> int:
        """Number of weights and biases; 237,571 in the published network."""
        return sum(array.size for array in self.parameters.values())

    def digest(self) -> bytes:
        """16 bytes that tell apart what predicts differently: of parameters, units and passes, whatever file they are from."""
        found = hashlib.blake2b(repr((self.trained_on, self.newton)).encode(), digest_size=16)
        for name, array in sorted(self.parameters.items()):
            found.update(f"{name}{array.shape}".encode())
            found.update(array.data)
        return found.digest()

    def layers(self, name: str) -> Layers:
        """A perceptron's layers, none where it is not there."""
        layers: Layers = []
        while (weight := self.parameters.get(f"{name}.{2 * len(layers)}.weight")) is not None:
            layers.append((weight, self.parameters.get(f"{name}.{2 * len(layers)}.bias")))
        return layers

    @classmethod
    def shipped(cls) -> Self:
        """The weights that come with the package.

        Raises
        ------
        ValueError
            Where this version brings none; `are_shipped` asks.
        """
        if not are_shipped():
            raise ValueError(
                "weights: this version of followthrough brings none for the emulator, expected a weights file "
                "(followthrough dataset and followthrough train make one), or another solver: implicit-euler (Simulation) or springs"
            )
        return cls.load(SHIPPED)

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a weights file; one without metadata is taken for a network of the paper.

        Raises
        ------
        ValueError
            Where the file cannot be read or holds something else; names the file.
        """
        arrays = read_npz(path)
        try:
            trained_on, manifest, newton = _metadata(arrays.pop(METADATA_KEY, None))
            return cls(arrays, trained_on, manifest, newton)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def save(self, path: Path | str) -> None:
        """Write a weights file, all or nothing.

        Raises
        ------
        ValueError
            Where the folder is missing.
        """
        metadata: dict[str, Any] = {
            "format": FORMAT,
            "network": self.network,
            "trained_on": asdict(self.trained_on),
            "manifest": self.manifest,
        }
        if self.newton is not None:
            metadata |= self.newton.metadata()
        write_npz(path, {**self.parameters, METADATA_KEY: np.array(json.dumps(metadata))})

    def _outputs(self, name: str) -> int:
        return len(self.layers(name)[-1][0])

    def _require_chain(self, name: str, inputs: int | None) -> int:
        """Check that a perceptron's layers fit each other, and return the number of its inputs."""
        layers = self.layers(name)
        if len(layers) < 2:
            raise ValueError(f"{name}: found {len(layers)} layer, expected at least 2")
        width = layers[0][0].shape[1] if inputs is None else inputs
        first = width
        for k, (weight, bias) in enumerate(layers):
            if weight.shape[1] != width:
                raise ValueError(
                    f"{name}.{2 * k}.weight: found shape {weight.shape}, expected ({len(weight)}, {width}), a column an input"
                )
            if bias is not None and len(bias) != len(weight):
                raise ValueError(f"{name}.{2 * k}.bias: found shape {bias.shape}, expected ({len(weight)},)")
            width = len(weight)
        return first


KINDS = ("weight", "bias")


def are_shipped() -> bool:
    """Whether weights come with the package; the emulator is then what bakes unless another solver is chosen."""
    return SHIPPED.is_file()


def _dimensions_of(name: str) -> int:
    if not re.fullmatch(r"\w+\.\d+\.(weight|bias)", name):
        raise ValueError(f"found {name}, expected only weights and biases such as edge_mlp.0.weight")
    return 2 if name.endswith(".weight") else 1


def _checked(name: str, array: NDArray[Any], dimensions: int) -> Float32Array:
    array = np.asarray(array)
    if array.dtype.kind != "f":
        raise ValueError(f"{name}: found {array.dtype}, expected float32")
    if array.ndim != dimensions or array.size == 0:
        expected = "(outputs, inputs)" if dimensions == 2 else "(outputs,)"
        raise ValueError(f"{name}: found shape {array.shape}, expected {expected}")
    with np.errstate(over="ignore"):
        array = np.ascontiguousarray(array, dtype=np.float32)
    if not np.isfinite(array).all():
        place = [int(i) for i in np.argwhere(~np.isfinite(array))[0]]
        raise ValueError(f"{name}: found {array[tuple(place)]} at {place}, expected finite numbers")
    return array


def _metadata(text: NDArray[Any] | None) -> tuple[TrainedOn, dict[str, Any], NewtonSchedule | None]:
    if text is None:
        return TrainedOn(), {}, None
    if text.ndim != 0 or text.dtype.kind != "U":
        raise ValueError(f"{METADATA_KEY}: found shape {text.shape} of {text.dtype}, expected one text")
    try:
        values = json.loads(str(text))
        version, network = values["format"], values["network"]
        trained = values["trained_on"]
        manifest = dict(values["manifest"])
        if version == FORMAT and network in NETWORKS:
            numbers = {f.name: trained[f.name] for f in fields(TrainedOn)}
            low, high = numbers.pop("stiffness_range")
            return (
                TrainedOn(**{name: float(n) for name, n in numbers.items()}, stiffness_range=(float(low), float(high))),
                manifest,
                NewtonSchedule.from_metadata(values) if network == "guided-newton" else None,
            )
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{METADATA_KEY}: found metadata that this version cannot read ({error!r})") from None
    raise ValueError(
        f"{METADATA_KEY}: found format {version} of a network called {network}, expected format {FORMAT} of "
        f"{' or '.join(NETWORKS)} (the file may be of a newer version of followthrough)"
    )
