"""Files are data: nothing in the sources reads a file in a way that would run code out of it."""

import ast
from collections.abc import Iterator

import pytest

from tests.integration.documents.pages import PROJECT_ROOT

SOURCES = sorted(
    file for folder in ("packages", "pipeline", "benchmarks") for file in (PROJECT_ROOT / folder).rglob("*.py")
)
PICKLERS = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
# They unpickle what another process of the same program sends, and no file.
OWN_PROCESSES = ("guarded_reading.py", "engines/task.py")
UNSAFE_YAML = {"load", "load_all", "unsafe_load", "full_load"}
# Without one of these words a text holds no such call, and need not be parsed.
WORDS = ("weights_only", "allow_pickle", "torch.load", "yaml", *PICKLERS)


def unsafe_calls(text: str) -> Iterator[str]:
    """Yields the calls that may run code out of a file."""
    if not any(word in text for word in WORDS):
        return
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call):
            continue
        for keyword in node.keywords:
            value = keyword.value.value if isinstance(keyword.value, ast.Constant) else "not written out"
            if keyword.arg == "weights_only" and value is not True:
                yield f"line {node.lineno}: weights_only is {value}"
            if keyword.arg == "allow_pickle" and value is not False:
                yield f"line {node.lineno}: allow_pickle is {value}"
        function = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        if function not in {"loads", "Unpickler", "open", *UNSAFE_YAML}:
            continue
        name = ast.unparse(node.func)
        module = name.rpartition(".")[0]
        if module in PICKLERS and function in ("load", "loads", "Unpickler", "open"):
            yield f"line {node.lineno}: {name}"
        if name == "torch.load" and not any(keyword.arg == "weights_only" for keyword in node.keywords):
            yield f"line {node.lineno}: torch.load without weights_only"
        if name in {f"yaml.{unsafe}" for unsafe in UNSAFE_YAML}:
            yield f"line {node.lineno}: {name}"


@pytest.mark.parametrize(
    "text",
    [
        "torch.load(file, weights_only=False)",
        "torch.load(file)",
        "np.load(path, allow_pickle=sure)",
        "def f():\n    return pickle.loads(data)",
        "yaml.load(stream, Loader=yaml.Loader)",
    ],
)
def test_an_unsafe_call_would_be_found(text: str) -> None:
    assert list(unsafe_calls(text))


def test_no_file_runs_code() -> None:
    assert len(SOURCES) > 200
    offences = [
        f"{file.relative_to(PROJECT_ROOT)}, {call}"
        for file in SOURCES
        if not file.as_posix().endswith(OWN_PROCESSES)
        for call in unsafe_calls(file.read_text(encoding="utf-8"))
    ]
    assert not offences
