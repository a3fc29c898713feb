"""Install what lock files say: each version and each hash as written there, and nothing else.

A lock is complete, so nothing is resolved (`--no-deps`): what an index offers besides can neither
come in nor disturb. uv installs in parallel; the environment's pip fetches it, pinned as all else,
and takes its place where there is no wheel of uv or where uv fails.

Of the user's settings those count that say where packages come from: a mirror, a proxy, a
certificate. They are read from pip, and both installers get them. Settings that say what is
installed, and where to (PIP_USER, PIP_TARGET, a constraint, ...), do not reach them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from configparser import Error as ConfigParserError
from configparser import RawConfigParser
from pathlib import Path
from urllib.parse import urlsplit

from steps import SetUpError, StepError, Steps

# pip's names of the settings that say how an index is reached.
_INDEX_SETTINGS = (
    "cache-dir",
    "cert",
    "client-cert",
    "default-timeout",
    "extra-index-url",
    "find-links",
    "index-url",
    "keyring-provider",
    "no-cache-dir",
    "no-index",
    "proxy",
    "retries",
    "timeout",
    "trusted-host",
)
# The variables by which uv is told the same.
_UV_NAMES = {
    "cert": ("SSL_CERT_FILE",),
    "client-cert": ("SSL_CLIENT_CERT",),
    "default-timeout": ("UV_HTTP_TIMEOUT",),
    "extra-index-url": ("UV_INDEX",),
    "find-links": ("UV_FIND_LINKS",),
    "index-url": ("UV_DEFAULT_INDEX",),
    "keyring-provider": ("UV_KEYRING_PROVIDER",),
    "no-cache-dir": ("UV_NO_CACHE",),
    "proxy": ("HTTP_PROXY", "HTTPS_PROXY"),
    "retries": ("UV_HTTP_RETRIES",),
    "timeout": ("UV_HTTP_TIMEOUT",),
    "trusted-host": ("UV_INSECURE_HOST",),
}
_UV_LISTS = {"find-links": ","}  # pip separates by white space, as uv does elsewhere
_TRUE = ("1", "true", "yes", "on", "y", "t")

# What either installer says when there is no way to an index.
_UNREACHABLE = (
    "connection broken",
    "connection error",
    "connect timeout",
    "connecttimeout",
    "error sending request",
    "max retries exceeded",
    "name resolution",
    "newconnectionerror",
    "network is unreachable",
    "proxyerror",
    "readtimeouterror",
    "sslerror",
)


class Installer:
    """Installs into one environment.

    Parameters
    ----------
    venv : Path
        The environment; it has pip.
    uv : Path
        The lock file with uv alone.
    steps : Steps
        Runs the programs.
    variables : mapping
        The environment variables of the user's shell.

    Raises
    ------
    SetUpError
        If pip's settings cannot be read.
    """

    def __init__(self, venv: Path, uv: Path, steps: Steps, variables: Mapping[str, str]) -> None:
        self._python = venv / "bin/python"
        self._folder = venv / ".installer"  # of uv: not part of the environment
        self._lock = uv
        self._steps = steps
        self._settings = _index_settings(self._python, variables)
        self._variables = _installer_variables(self._settings, variables)
        self._uv: Path | None = None

    def __enter__(self) -> Installer:
        shutil.rmtree(self._folder, ignore_errors=True)
        try:
            self._pip("installer", "-r", self._lock, "--target", self._folder)
            self._uv = self._folder / "bin/uv"
        except StepError as error:
            print(f"  uv cannot be had ({_last_line(error.output)}); pip does its work")
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def install(self, step: str, *locks: Path) -> None:
        """Install what some lock files say; they share versions where they share packages.

        Raises
        ------
        SetUpError
            If it is not to be had, or not with the hash that the lock says.
        """
        files = [argument for lock in locks for argument in ("-r", lock)]
        if self._uv:
            flags = ["--no-index"] if _is_true(self._settings.get("no-index", "")) else []
            command: list[str | Path] = [
                self._uv,
                "pip",
                "install",
                "--python",
                self._python,
                "--no-config",
                *flags,
            ]
            # With one version and its hashes given, it does not matter which index it comes from.
            command += ["--index-strategy", "unsafe-best-match", "--no-progress"]
            try:
                self._steps.run(
                    step, [*command, *_ONLY_THE_LOCK, *files], environment=self._variables
                )
                return
            except StepError as error:
                print(f"  uv cannot do it ({_last_line(error.output)}); pip tries")
        self._pip(f"{step}, by pip", *files)

    def _pip(self, step: str, *arguments: str | Path) -> None:
        command: list[str | Path] = [self._python, "-m", "pip", "install", "--no-input"]
        # Python compiles what it imports when it first does: most is never imported.
        command += ["--quiet", "--use-pep517", "--no-compile", *_ONLY_THE_LOCK]
        try:
            self._steps.run(step, [*command, *arguments], environment=self._variables)
        except StepError as error:
            if any(words in error.output.lower() for words in _UNREACHABLE):
                raise SetUpError(
                    f"no package index could be reached ({_index_of(self._settings)}). Look at the "
                    "network, at the proxy and at what `pip config list` says of index and "
                    "certificate; then call make again."
                ) from None
            raise


# Nothing is resolved, nothing is built but the one package that has no wheel, and that with what
# is installed: an isolated build would take the newest build tools there are.
_ONLY_THE_LOCK = (
    "--require-hashes",
    "--no-deps",
    "--no-build-isolation",
    "--only-binary=:all:",
    "--no-binary=empy",
)


def _index_settings(python: Path, variables: Mapping[str, str]) -> dict[str, str]:
    """Return what pip is told, by files and variables, of the way to an index."""
    found: dict[str, dict[str, str]] = {"global": {}, "install": {}}
    for file in _pip_files(python, variables):
        parser = RawConfigParser()
        try:
            parser.read(file)
        except (ConfigParserError, UnicodeDecodeError) as error:
            said = " ".join(str(error).split())
            raise SetUpError(f"pip's settings cannot be read: {said}") from None
        for section in found:
            if parser.has_section(section):
                found[section].update(
                    (key.lower().replace("_", "-"), value) for key, value in parser.items(section)
                )
    by_variable = {
        name.removeprefix("PIP_").lower().replace("_", "-"): value
        for name, value in variables.items()
        if name.startswith("PIP_")
    }
    settings = {**found["global"], **found["install"], **by_variable}
    # Of several lines in a file pip makes one.
    return {name: " ".join(settings[name].split()) for name in _INDEX_SETTINGS if name in settings}


def _pip_files(python: Path, variables: Mapping[str, str]) -> list[Path]:
    """Return pip's own files of settings, the stronger ones last.

    `pip config list` would be simpler, but what is set in the files changes what it lists.
    """
    done = subprocess.run(
        [python, "-m", "pip", "config", "debug"],
        env={name: value for name, value in variables.items() if name in _FOR_PIPS_FILES},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        raise SetUpError(f"pip cannot read its settings: {_last_line(done.stderr)}")
    files: dict[str, list[Path]] = {}
    for line in done.stdout.splitlines():
        kind = re.fullmatch(r"(\w+):", line)
        file = re.fullmatch(r"  (/.+), exists: True", line)
        if kind:
            files[kind[1]] = []
        elif file:
            list(files.values())[-1].append(Path(file[1]))
    return [file for kind in ("global", "user", "site", "env") for file in files.get(kind, ())]


_FOR_PIPS_FILES = ("HOME", "PATH", "PIP_CONFIG_FILE", "XDG_CONFIG_HOME", "XDG_CONFIG_DIRS")


def _installer_variables(
    settings: Mapping[str, str], variables: Mapping[str, str]
) -> dict[str, str]:
    """Return the environment variables for pip and for uv."""
    kept = {
        name: value
        for name, value in variables.items()
        if not name.startswith(("PIP_", "UV_")) or name == "UV_CACHE_DIR"
    }
    kept["PIP_CONFIG_FILE"] = os.devnull
    kept["PIP_DISABLE_PIP_VERSION_CHECK"] = "1"
    for setting, value in settings.items():
        kept[f"PIP_{setting.upper().replace('-', '_')}"] = value
        for name in _UV_NAMES.get(setting, ()):
            kept[name] = value.replace(" ", _UV_LISTS.get(setting, " "))
    if "SSL_CERT_FILE" not in kept:  # pip also heeds these
        for name in ("REQUESTS_CA_BUNDLE", "CURL_CA_BUNDLE"):
            if variables.get(name):
                kept["SSL_CERT_FILE"] = variables[name]
                break
    for installer, off in (("UV", "UV_NO_CACHE"), ("PIP", "PIP_NO_CACHE_DIR")):
        if not _can_be_made(Path(kept.get(f"{installer}_CACHE_DIR") or _cache_home(variables))):
            kept[off] = "1"
    return kept


def _cache_home(variables: Mapping[str, str]) -> Path:
    """Return where programs keep what can be made again."""
    return Path(variables.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def _can_be_made(folder: Path) -> bool:
    """Whether a folder can be written, once it is made: below some, like /proc, none can be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _is_true(value: str) -> bool:
    return value.strip().lower() in _TRUE


def _index_of(settings: Mapping[str, str]) -> str:
    """Return which index it is, without what may be a password."""
    if _is_true(settings.get("no-index", "")):
        return "pip is told to use none"
    if "index-url" not in settings:
        return "the one that pip uses by default"
    parts = urlsplit(settings["index-url"])
    return parts.hostname or parts.path


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"
