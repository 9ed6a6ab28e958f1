"""The command `endonav hub`: policies and data sets to and from the Hugging Face Hub, by huggingface_hub.

Who uploads is known to it by `hf auth login` or HF_TOKEN; HF_ENDPOINT names another server.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.printing import Parser, say
from pipeline.store.errors import ConfigurationError

_FINE, _FAILED, _USAGE = 0, 1, 2
_DATASETS = "datasets/"  # begins the address of a data set, as on the site
_SUFFIXES = (".pt", ".onnx")  # of policies
_CARD = "README.md"
_NOT_UPLOADED = [".*", ".*/**", "**/.*", "**/.*/**"]  # Hydra's and stages' own
_LIBRARY = "endonav"


def main(arguments: Sequence[str]) -> int:
    """Runs the command; 1 where the Hub refuses, 2 for wrong usage."""
    parser = Parser(prog="endonav hub", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="upload|download")
    up = verbs.add_parser("upload", help="a policy's file to USER/NAME, a folder to datasets/USER/NAME")
    up.add_argument("path", type=Path, metavar="FILE|FOLDER")
    up.add_argument("address")
    up.add_argument("--private", action="store_true", help="where it is made")
    down = verbs.add_parser("download", help="all files of USER/NAME or datasets/USER/NAME")
    down.add_argument("address")
    down.add_argument("--to", type=Path, metavar="FOLDER", help="without: its name")
    options = parser.parse_args(arguments)
    try:
        if options.verb == "upload":
            say(upload(options.path, options.address, private=options.private))
        else:
            say("\n".join(map(str, download(options.address, options.to or Path(options.address.rpartition("/")[2])))))
    except ConfigurationError as error:
        say(f"endonav hub: {error}", error=True)
        return _USAGE
    except Exception as error:
        if not isinstance(error, (OSError, ValueError)) and "http" not in type(error).__module__:
            raise
        words = str(error).strip() or type(error).__name__  # of the Hub's library, or of the one that it sends by
        say(f"endonav hub: {words.splitlines()[0]}", error=True)
        return _FAILED
    return _FINE


def upload(path: Path, address: str, *, private: bool = False) -> str:
    """Uploads a policy with a card, or a folder as a data set; the repository is made where it is not there.

    Args:
        path: a policy, whose card is the text beside it (`<name>.md`) or made of what its file says; or a folder.
        address: USER/NAME for a policy, datasets/USER/NAME for a folder.

    Returns:
        Where it is.

    Raises:
        ConfigurationError: it is no policy that can be read, or no folder, or the address is of the other kind.
        ModuleNotFoundError: huggingface_hub is not installed.
        OSError: the Hub refuses it.
    """
    from pipeline.protocol.board import read_any_policy, require_policy_file

    repository = _repository(address)
    if repository["repo_type"] == "dataset" and not path.exists():
        raise ConfigurationError(f"there is no folder {path}")
    if path.is_dir() != (repository["repo_type"] == "dataset"):
        raise ConfigurationError(f"a policy goes to USER/NAME, a folder to datasets/USER/NAME: {path} to {address}")
    card = ""
    if not path.is_dir():
        require_policy_file(path)
        policy = read_any_policy(path)
        beside = path.with_suffix(".md")
        card = beside.read_text(encoding="utf-8") if beside.is_file() else _card(path.stem, policy)
    elif not any(path.rglob("*")):
        raise ConfigurationError(f"{path} is empty")
    api = _library().HfApi(library_name=_LIBRARY)
    made = api.create_repo(**repository, private=private, exist_ok=True)
    if path.is_dir():
        api.upload_folder(**repository, folder_path=path, ignore_patterns=_NOT_UPLOADED)
    else:
        head = "" if card.startswith("---\n") else _HEAD
        for name, content in ((path.name, str(path)), (_CARD, (head + card).encode())):
            api.upload_file(**repository, path_in_repo=name, path_or_fileobj=content)
    return str(made)


def download(address: str, folder: Path) -> list[Path]:
    """Downloads a repository's files; policies among them are read, which runs no code of theirs.

    Returns:
        The files.

    Raises:
        ConfigurationError: the address is none.
        ModuleNotFoundError: huggingface_hub is not installed.
        OSError: the Hub does not give it.
        ValueError: a policy is damaged.
    """
    from pipeline.protocol.board import read_any_policy

    repository = _repository(address)
    _library().snapshot_download(**repository, local_dir=folder, library_name=_LIBRARY)
    hidden = folder / ".cache"  # the library's
    files = sorted(path for path in folder.rglob("*") if path.is_file() and hidden not in path.parents)
    for path in files:
        if repository["repo_type"] == "model" and path.suffix in _SUFFIXES:
            read_any_policy(path)
    return files


_HEAD = f"---\nlibrary_name: {_LIBRARY}\ntags: [robotics, reinforcement-learning, endovascular]\n---\n"


def _card(name: str, policy: Any) -> str:
    metadata = {
        "observations": list(policy.keys) or ["tracking"],
        "steps of an action": policy.action_repeat,
        **getattr(policy, "metadata", {}),
    }
    rows = "\n".join(f"| {key} | `{json.dumps(value, default=str)}` |" for key, value in metadata.items())
    return (
        f"# {name}\n\nA policy of EndoNav, not for clinical use. `endonav evaluate --policy FILE` plays it.\n\n"
        f"| | |\n|---|---|\n{rows}\n"
    )


def _repository(address: str) -> dict[str, str]:
    kind = "dataset" if address.startswith(_DATASETS) else "model"
    repository = address.removeprefix(_DATASETS)
    if repository.count("/") != 1 or not all(repository.split("/")):
        raise ConfigurationError(f"the address {address!r} is not USER/NAME, nor datasets/USER/NAME")
    return {"repo_id": repository, "repo_type": kind}


def _library() -> Any:
    try:
        import huggingface_hub
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the Hub needs huggingface_hub: pip install 'endonav[hub]'", name=error.name
        ) from None
    return huggingface_hub
