"""A second device: the GPU where there is one; elsewhere one whose tensors are kept on the CPU and must not be mixed.

On a machine without a GPU torch's place for devices that others write is given a device `elsewhere`. Inside
`second_device()` networks can be brought there, computed with and trained; an operation on tensors of both devices
fails as it does beside a GPU, and so does turning a tensor into an array that was not brought back first.
What this cannot show: other rounding, kernels that a GPU lacks, its memory, and its random numbers.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map
from torch.utils.backend_registration import _DummyBackendModule, _setup_privateuseone_for_python_backend

NAME = "elsewhere"
# operations that a GPU, too, takes from both devices: copies, and indices on the CPU
_BETWEEN = {"_to_copy", "copy_", "index", "index_put", "index_put_", "_index_put_impl_"}
_registered = False


class _Backend(_DummyBackendModule):
    def get_amp_supported_dtype(self) -> list[torch.dtype]:
        return [torch.float16, torch.bfloat16]


class Elsewhere(torch.Tensor):
    """A tensor of the second device."""

    here: torch.Tensor

    @staticmethod
    def __new__(cls, here: torch.Tensor) -> torch.Tensor:
        made: Any = torch.Tensor._make_wrapper_subclass(
            cls,
            here.size(),
            strides=here.stride(),
            storage_offset=here.storage_offset(),
            dtype=here.dtype,
            device=torch.device(NAME, 0),
        )
        made.here = here
        return made

    def __repr__(self, *, tensor_contents: Any = None) -> str:
        return f"Elsewhere({self.here})"

    def numpy(self, *, force: bool = False) -> Any:
        raise TypeError("can't convert a tensor of another device to numpy: bring it to the CPU first")

    def tolist(self) -> Any:
        return self.cpu().tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class _SecondDevice(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    if torch._C._dispatch_has_kernel_for_dispatch_key(func.name(), "CompositeImplicitAutograd"):
        with _SecondDevice():  # without gradients operations come here as a whole
            return func.decompose(*args, **kwargs)
    tensors = [one for one in tree_flatten((args, kwargs))[0] if isinstance(one, torch.Tensor)]
    there = [one for one in tensors if isinstance(one, Elsewhere)]
    wanted = kwargs.get("device")
    to_there = bool(there) if wanted is None else torch.device(wanted).type == NAME
    if wanted is not None:
        kwargs = {**kwargs, "device": torch.device("cpu")}
    name = func.overloadpacket.__name__
    mixed = there and any(one.dim() > 0 for one in tensors if not isinstance(one, Elsewhere))
    if mixed and name not in _BETWEEN:
        raise RuntimeError(f"expected all tensors to be on the same device, but {func} got some of both")
    given = {id(_here(one)): one for one in tensors}
    compute = _GATED.get(name, func)

    def placed(one: Any) -> Any:
        if not isinstance(one, torch.Tensor):
            return one
        if id(one) in given and wanted is None:  # in place
            return given[id(one)]
        return Elsewhere(one) if to_there else one

    with torch.inference_mode(False), torch.no_grad(), torch._C._DisableTorchDispatch():
        out = compute(*tree_map(_here, args), **tree_map(_here, kwargs))
        return args[0] if name == "copy_" else tree_map(placed, out)


def _gated_cell(inputs: Any, hidden: Any, before: Any, input_bias: Any = None, hidden_bias: Any = None) -> Any:
    """One step of a gated recurrent unit, which torch computes at once on other devices than the CPU."""
    if input_bias is not None:
        inputs, hidden = inputs + input_bias, hidden + hidden_bias
    (r, z, n), (hr, hz, hn) = inputs.chunk(3, 1), hidden.chunk(3, 1)
    r, z = torch.sigmoid(r + hr), torch.sigmoid(z + hz)
    n = torch.tanh(n + r * hn)
    return n + z * (before - n), torch.cat((r, z, n, before, hn), 1)


def _gated_cell_backward(gradient: Any, kept: Any, has_bias: bool) -> Any:
    r, z, n, before, hn = kept.chunk(5, 1)
    dn = gradient * (1 - z) * (1 - n * n)
    dz, dr = gradient * (before - n) * z * (1 - z), dn * hn * r * (1 - r)
    inputs, hidden = torch.cat((dr, dz, dn), 1), torch.cat((dr, dz, dn * r), 1)
    biases = (inputs.sum(0), hidden.sum(0)) if has_bias else (None, None)
    return inputs, hidden, gradient * z, *biases


_GATED = {"_thnn_fused_gru_cell": _gated_cell, "_thnn_fused_gru_cell_backward": _gated_cell_backward}


def _here(one: Any) -> Any:
    return one.here if isinstance(one, Elsewhere) else one


@contextmanager
def _float32_on_gpu() -> Iterator[None]:
    """Products in float32 as on the CPU, instead of its shorter form."""
    kept = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = kept


def tolerance(copied: float, gpu: float) -> float:
    """How far results of two devices may differ.

    Args:
        copied: beside tensors that are kept on the CPU.
        gpu: on a GPU, which rounds differently: many updates enlarge that.
    """
    return gpu if torch.cuda.is_available() else copied


@contextmanager
def second_device() -> Iterator[str]:
    """Inside, torch has a second device; gives its name."""
    global _registered
    if torch.cuda.is_available():
        with _float32_on_gpu():
            yield "cuda:0"
        return
    if not _registered:
        _setup_privateuseone_for_python_backend(NAME, backend_module=_Backend())
        _registered = True
    # parameters stay the same objects when their module moves, as beside a GPU: optimisers hold on to them
    move: Any = torch.nn.Module._apply

    def moved_in_place(module: torch.nn.Module, fn: Any, recurse: bool = True) -> torch.nn.Module:
        torch.__future__.set_swap_module_params_on_conversion(True)
        try:
            return move(module, fn, recurse)
        finally:
            torch.__future__.set_swap_module_params_on_conversion(False)

    recurrent: Any = torch._VF.gru  # type: ignore[attr-defined]

    def time_first(inputs: torch.Tensor, before: torch.Tensor, weights: Any, *rest: Any) -> Any:
        # torch turns a batch's result in place, which a tensor that keeps another does not notice
        if rest[-1] is not True:
            return recurrent(inputs, before, weights, *rest)
        told, after = recurrent(inputs.transpose(0, 1), before, weights, *rest[:-1], False)
        return told.transpose(0, 1), after

    torch.nn.Module._apply = moved_in_place  # type: ignore[method-assign]
    torch._VF.gru = time_first  # type: ignore[attr-defined]
    try:
        with _SecondDevice():
            yield f"{NAME}:0"
    finally:
        torch.nn.Module._apply = move  # type: ignore[method-assign]
        torch._VF.gru = recurrent  # type: ignore[attr-defined]
