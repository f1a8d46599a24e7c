"""Two other ways to combine a network's two observations, to compare with the paper's."""

from __future__ import annotations

from typing import Any

from analysis.tunenet.network import Network, Weights, layer, linear, relu, tanh


class DifferenceNetwork:
    """Paper's network with the difference of its two intermediate outputs, not both.

    The paper found the concatenation better (its section on the network).
    """

    kind = "difference"
    width = 32

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("proposed", inputs, self.width),
            **layer("target", inputs, self.width),
            **layer("joint", self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "proposed", proposed))
        of_target = relu(linear(weights, "target", target))
        joint = relu(linear(weights, "joint", of_target - of_proposed))
        return tanh(linear(weights, "out", joint))


class Antisymmetrised:
    """h(o_P, o_T) = (g(o_P, o_T) - g(o_T, o_P)) / 2 of another network g, with g's weights.

    It is exactly 0 where both observations are equal, for any weights.
    """

    def __init__(self, network: Network) -> None:
        self._network = network

    @property
    def kind(self) -> str:
        """See `Network.kind`."""
        return f"antisymmetric {self._network.kind}"

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return self._network.shapes(inputs, outputs)

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        forth = self._network.residual(weights, proposed, target)
        return (forth - self._network.residual(weights, target, proposed)) / 2
