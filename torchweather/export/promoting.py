"""Casts of operands of mixed types, found from the values that a traced program already holds.

``torch.onnx.export`` runs the whole program once more, on tensors without data, to find where an operand needs a cast.
Every node of a traced program holds the type of what it gives, so that only the operations that do get a cast are run.

This reaches into parts of torch that may change between its versions. Where one is missing, torch's own way runs: the
same graph, later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from torch import fx

__all__ = ["promoting_by_held_types"]


def _insert(graph_module: fx.GraphModule, passes: Any) -> bool:
    """Casts in a program, in place; ``False`` where a node does not hold what it gives."""

    class Promotion(passes._TypePromotionInterpreter):  # type: ignore[misc]
        """The interpreter of torch's pass, which takes each node's value from the node."""

        def run_node(self, n: fx.Node) -> Any:
            """Give what the node holds; its operands get their casts."""
            if n.op == "output":
                return None
            rule = passes.get_type_promotion_rule(n, self.type_promotion_table)
            if rule:
                with self._set_current_node(n):
                    self._maybe_promote_node(n, rule)
            return n.meta.get("val")

    nodes = [node for node in graph_module.graph.nodes if node.op == "call_function"]
    if any("val" not in node.meta for node in nodes) or len([*graph_module.modules()]) != 1:
        return False
    promotion = passes.InsertTypePromotion(graph_module)
    promotion.interpreter = Promotion(graph_module, passes.TypePromotionTable())
    promotion.run()
    return True


def _parts() -> tuple[Any, Any] | None:
    """The two modules of torch in which this takes part; ``None`` where this torch has them not, or not so."""
    try:
        from torch.onnx._internal.exporter import _fx_passes
        from torch.onnx._internal.fx.passes import type_promotion
    except ImportError:
        return None
    needed = ("_TypePromotionInterpreter", "InsertTypePromotion", "TypePromotionTable", "get_type_promotion_rule")
    there = hasattr(_fx_passes, "insert_type_promotion_nodes") and all(hasattr(type_promotion, one) for one in needed)
    return (_fx_passes, type_promotion) if there else None


@contextmanager
def promoting_by_held_types() -> Iterator[None]:
    """While it is open, ``torch.onnx.export`` inserts casts in this way."""
    found = _parts()
    if found is None:
        yield
        return
    exporter, promotion = found
    whole: Callable[[fx.GraphModule], None] = exporter.insert_type_promotion_nodes

    def insert(graph_module: fx.GraphModule) -> None:
        if not _insert(graph_module, promotion):
            whole(graph_module)

    passes = vars(exporter)
    passes[whole.__name__] = insert
    try:
        yield
    finally:
        passes[whole.__name__] = whole
