"""Programs of ``torch.export`` whose decomposition touches only the nodes that need one.

``ExportedProgram.run_decompositions`` traces the whole program again, twice, to replace a few operations that ONNX does
not have. That is half of the time of an export. Here those nodes alone are replaced, and all others stay as they are.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import fx
from torch.export import ExportedProgram
from torch.fx.experimental.proxy_tensor import make_fx

__all__ = ["DecomposedByNode", "decompose_nodes"]

aten = torch.ops.aten
Table = Mapping[Any, Callable[..., Any]]
# Made of other operations, and known to ONNX as they are.
WHOLE = {aten.reshape.default, aten.flatten.using_ints, aten.expand_as.default, aten.contiguous.default}


class DecomposedByNode(ExportedProgram):
    """An exported program whose ``run_decompositions`` replaces single nodes.

    A program with operations that no rule here covers, or that changes in place what something else may read, is
    decomposed in torch's own way.
    """

    @classmethod
    def of(cls, program: ExportedProgram) -> DecomposedByNode:
        """The same program."""
        program.__class__ = cls
        assert isinstance(program, cls)
        return program

    def run_decompositions(
        self, decomp_table: dict[Any, Callable[..., Any]] | None = None, decompose_custom_triton_ops: bool = False
    ) -> ExportedProgram:
        """The program without the operations of a table; in place, except where torch's own way is taken.

        Args:
            decomp_table: operation to its decomposition.
            decompose_custom_triton_ops: as in torch.
        """
        if decomp_table is not None and decompose_nodes(self.graph_module, decomp_table):
            return self
        whole: ExportedProgram = super().run_decompositions(decomp_table, decompose_custom_triton_ops)
        return whole


def decompose_nodes(module: fx.GraphModule, table: Table) -> bool:
    """Replace each node of a graph whose operation is in a table, or made of others, by its decomposition.

    Args:
        module: the graph; its nodes hold what they give as ``meta["val"]``.
        table: operation to its decomposition.

    Returns:
        ``False`` where a node has no rule; the graph gives what it gave then.
    """
    graph = module.graph
    graph.eliminate_dead_code()
    nodes = [node for node in graph.nodes if node.op == "call_function"]
    changing = {node: _functional(node) for node in nodes if _is_changing(node)}
    kept = WHOLE | set(torch.export.default_decompositions())
    targets = {node: changing.get(node, node.target) for node in nodes}
    replaced = [node for node in nodes if _is_made_of_others(targets[node], table, kept)]
    if None in changing.values() or any(node.op == "get_attr" for node in graph.nodes):
        return False
    if any(targets[node] not in RULES and not (targets[node] in table and _gives_a_tensor(node)) for node in replaced):
        return False
    for node, functional in changing.items():
        node.target = functional
    for node in replaced:
        with graph.inserting_before(node):
            rule = RULES.get(node.target)
            result = _inlined(node, table) if rule is None else rule(graph, node)
        if "val" not in result.meta:
            result.meta = dict(node.meta)
        node.replace_all_uses_with(result)
        graph.erase_node(node)
    graph.eliminate_dead_code()
    module.recompile()
    return True


def _is_made_of_others(target: Any, table: Table, kept: set[Any]) -> bool:
    if target in table:
        return True
    if not isinstance(target, torch._ops.OpOverload) or target in kept:
        return False
    return target.has_kernel_for_dispatch_key(torch._C.DispatchKey.CompositeImplicitAutograd)


def _gives_a_tensor(node: fx.Node) -> bool:
    return isinstance(node.meta.get("val"), torch.Tensor)


def _is_changing(node: fx.Node) -> bool:
    schema = getattr(node.target, "_schema", None)
    return schema is not None and bool(schema.is_mutable) and node.target != aten._assert_tensor_metadata.default


def _functional(node: fx.Node) -> Any:
    """The operation that gives what an in-place operation leaves; ``None`` where something else may read its input."""
    packet, _, overload = str(node.target).removeprefix("aten.").partition(".")
    changed = node.args[0]
    if not packet.endswith("_") or not isinstance(changed, fx.Node) or len(changed.users) != 1:
        return None
    if _is_changing(changed):
        if _functional(changed) is None:
            return None
    else:
        schema = getattr(changed.target, "_schema", None)
        if schema is None or any(one.alias_info is not None for one in schema.returns):
            return None
    return getattr(getattr(aten, packet.removesuffix("_"), None), overload, None)


# ---- rules: a graph and a node of it to the node that takes its place ------------------------------------------------


def _cast(graph: fx.Graph, node: fx.Node) -> fx.Node:
    """``to`` another type; the device is that of the graph."""
    given, wanted = node.args[0], node.meta["val"].dtype
    assert isinstance(given, fx.Node)
    if given.meta["val"].dtype == wanted:
        return given
    return graph.call_function(aten._to_copy.default, (given,), {"dtype": wanted})


def _as(target: Any) -> Callable[[fx.Graph, fx.Node], fx.Node]:
    """Another operation of the same arguments."""
    return lambda graph, node: graph.call_function(target, node.args, node.kwargs)


def _square(graph: fx.Graph, node: fx.Node) -> fx.Node:
    return graph.call_function(aten.mul.Tensor, (node.args[0], node.args[0]))


def _reversed_difference(graph: fx.Graph, node: fx.Node) -> fx.Node:
    return graph.call_function(aten.sub.Tensor, (node.args[1], node.args[0]))


def _number_of_entries(graph: fx.Graph, node: fx.Node) -> fx.Node:
    given = node.args[0]
    assert isinstance(given, fx.Node)
    sizes = [graph.call_function(aten.sym_size.int, (given, axis)) for axis in range(given.meta["val"].ndim)]
    for axis, size in enumerate(sizes):
        size.meta["val"] = given.meta["val"].shape[axis]
    product = sizes[0]
    for size in sizes[1:]:
        product, before = graph.call_function(operator.mul, (product, size)), product
        product.meta["val"] = before.meta["val"] * size.meta["val"]
    return product


def _permuted(graph: fx.Graph, node: fx.Node) -> fx.Node:
    given = node.args[0]
    assert isinstance(given, fx.Node)
    axes = list(range(given.meta["val"].ndim))
    if node.target == aten.numpy_T.default:
        axes.reverse()
    else:
        source, target = (int(one) % len(axes) for one in node.args[1:3])  # type: ignore[arg-type]
        axes.insert(target, axes.pop(source))
    return graph.call_function(aten.permute.default, (given, axes))


RULES: dict[Any, Callable[[fx.Graph, fx.Node], fx.Node]] = {
    aten.to.dtype: _cast,
    aten.to.device: _cast,
    aten.to.dtype_layout: _cast,
    aten.__and__.Tensor: _as(aten.bitwise_and.Tensor),
    aten.__or__.Tensor: _as(aten.bitwise_or.Tensor),
    aten.square.default: _square,
    aten.rsub.Scalar: _reversed_difference,
    aten.sym_numel.default: _number_of_entries,
    aten.item.default: _as(aten._local_scalar_dense.default),
    aten.numpy_T.default: _permuted,
    aten.movedim.int: _permuted,
}


def _inlined(node: fx.Node, table: Table) -> fx.Node:
    """Put the decomposition of a node before it."""
    flat, spec = torch.utils._pytree.tree_flatten((node.args, node.kwargs))
    inputs = [one for one in flat if isinstance(one, fx.Node)]
    target = node.target
    assert callable(target)

    def function(*values: Any) -> Any:
        left = iter(values)
        every = [next(left) if isinstance(one, fx.Node) else one for one in flat]
        args, kwargs = torch.utils._pytree.tree_unflatten(every, spec)
        return target(*args, **kwargs)

    traced = make_fx(function, decomposition_table=dict(table))(*(one.meta["val"] for one in inputs))
    places = dict(zip((one for one in traced.graph.nodes if one.op == "placeholder"), inputs, strict=True))
    result = node.graph.graph_copy(traced.graph, places)
    assert isinstance(result, fx.Node)
    return result
