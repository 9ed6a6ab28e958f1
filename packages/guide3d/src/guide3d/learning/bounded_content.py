"""Content of torch's files, read and turned into networks within limits that the file's own size sets.

`torch.load` with `weights_only` runs no code, but builds whatever a file asks for: a tensor of any size, of a kind that
no network here has, lists that hold themselves, archives that unpack to a thousand times their size.
"""

from __future__ import annotations

import io
import math
import pickletools
import zipfile
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

_REAL = ("Float", "Double", "Half", "BFloat16", "Byte", "Char", "Short", "Int", "Long", "Bool")
_STORAGES = (*_REAL, "ComplexFloat", "ComplexDouble")
_KNOWN = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    "torch._utils _rebuild_tensor_v3",  # of whole numbers without a sign, as states of generators have
    "torch._utils _rebuild_parameter",
    "torch.storage UntypedStorage",
    *(f"torch uint{bits}" for bits in (16, 32, 64)),
    *(f"torch {kind}Storage" for kind in _STORAGES),
}
_DEEPEST = 100  # containers in each other
_MOST_PARTS = 300_000
_LEAST_TENSOR = 4096  # numbers that the smallest tensor counts as: many of them take time
_ALWAYS_BUILT = 1 << 24  # numbers that a network of any file may have, and times those in it: critics and their targets
_TIMES_BUILT = 32  # are often left out, and drawing first weights takes memory, too


def load_content(body: bytes | memoryview) -> Any:
    """The numbers, strings, lists, tuples, dictionaries and tensors of what `torch.save` wrote, on the CPU.

    Raises:
        ValueError: it holds something else, or more than its bytes.
        Exception: whatever `torch.load` raises for damaged bytes.
    """
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        entries = archive.infolist()
        if any(one.compress_type != zipfile.ZIP_STORED for one in entries):
            raise ValueError("it is compressed, which torch.save never does")
        if sum(one.file_size for one in entries) > len(body):
            raise ValueError("its parts are larger than the file")
        for name in (one.filename for one in entries if one.filename.endswith("data.pkl")):
            for operation, argument, _ in pickletools.genops(archive.read(name)):
                if operation.name in ("GLOBAL", "INST", "STACK_GLOBAL") and argument not in _KNOWN:
                    raise ValueError(f"it holds {str(argument)[:60]!r}, which no network has")
    with Bounded(_ALWAYS_BUILT + len(body)):
        content = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    total = sum(tensor.numel() * tensor.element_size() for _, tensor in tensors(content))
    if total > 4 * len(body):  # parts of networks share weights, but not more than that
        raise ValueError("its tensors are larger than the file")
    return content


def tensors(content: Any) -> Iterator[tuple[str, Tensor]]:
    """The tensors in content, with their places.

    Raises:
        ValueError: containers are too deep in each other, as in one that holds itself, or hold too many parts.
    """
    todo: list[tuple[tuple[Any, ...], Any]] = [((), content)]
    parts = 0
    while todo:
        place, value = todo.pop()
        parts += 1
        if len(place) > _DEEPEST or parts > _MOST_PARTS:
            raise ValueError("its parts are too deep in each other, or too many")
        if isinstance(value, Tensor):
            yield "/".join(map(str, place)), value
        elif isinstance(value, dict | list | tuple):
            inner = value.items() if isinstance(value, dict) else enumerate(value)
            todo += reversed([((*place, name), part) for name, part in inner])


def built_from(content: Any) -> Bounded:
    """Limits what is built while its body runs to what a network with the tensors of a file may need."""
    return Bounded(_ALWAYS_BUILT + _TIMES_BUILT * sum(tensor.numel() for _, tensor in tensors(content)))


class Bounded(TorchDispatchMode):
    """Refuses tensors before they are made, once all together have more than so many numbers.

    Raises:
        ValueError: by whatever asks for the next tensor.
    """

    def __init__(self, numbers: int) -> None:
        super().__init__()
        self._left = numbers

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # torch asks this since 2.8: to leave torch.compile out, it would import it, which takes 2 CPU-s

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None) -> Any:
        """Counts the sizes that an operation is given."""
        lists = (part for part in args if isinstance(part, list | tuple) and all(type(one) is int for one in part))
        count = math.prod(map(abs, next(lists, (0,))))  # the first is the size, a second one the strides
        if not any(isinstance(part, Tensor) for part in args):  # arange(n), eye(n)
            count = max(count, *(abs(int(part)) for part in args if isinstance(part, int | float) and part == part), 0)
        self._left -= max(count, _LEAST_TENSOR if count else 0)
        if self._left < 0:
            raise ValueError("its settings or sizes ask for far more numbers than it holds")
        return func(*args, **(kwargs or {}))
