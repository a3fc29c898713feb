"""What is installed depends on the lock alone, whatever an index offers besides."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest
from harness import PATIENCE

ROOT = Path(__file__).resolve().parent.parent
PYTHON = getattr(sys, "_base_executable", sys.executable)


# Packages and an index, made here -------------------------------------------------------------


def wheel(
    name: str,
    version: str,
    files: Mapping[str, bytes],
    metadata: str = "",
    scripts: Mapping[str, bytes] | None = None,
    tag: str = "py3-none-any",
) -> tuple[str, bytes]:
    """File name and content of a wheel."""
    stem = f"{name.replace('-', '_')}-{version}"
    info = f"{stem}.dist-info"
    content = {
        **files,
        **{f"{stem}.data/scripts/{key}": value for key, value in (scripts or {}).items()},
        f"{info}/METADATA": (
            f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{metadata}".encode()
        ),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\n"
        + f"Tag: {tag}\n".encode(),
    }
    record = []
    for path, data in content.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        record.append(f"{path},sha256={digest},{len(data)}")
    content[f"{info}/RECORD"] = "\n".join([*record, f"{info}/RECORD,,", ""]).encode()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path, data in content.items():
            member = zipfile.ZipInfo(path)
            runs = ".data/scripts/" in path
            member.external_attr = (0o100755 if runs else 0o100644) << 16
            archive.writestr(member, data)
    return f"{stem}-{tag}.whl", packed.getvalue()


def source(name: str, version: str, trace: Path | None = None) -> tuple[str, bytes]:
    """File name and content of a source package; being built it leaves a trace, if asked to."""
    built, data = wheel(name, version, {f"{name}.py": b""})
    backend = "def build_wheel(folder, settings=None, metadata=None):\n"
    if trace:
        backend += f"    open({str(trace)!r}, 'a').write({name + ' ' + version!r})\n"
    backend += f"    open(folder + '/{built}', 'wb').write({data!r})\n    return {built!r}\n"
    files = {
        "PKG-INFO": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        "backend.py": backend,
        "pyproject.toml": "[build-system]\nrequires = []\n"
        'build-backend = "backend"\nbackend-path = ["."]\n',
    }
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for path, text in files.items():
            member = tarfile.TarInfo(f"{name}-{version}/{path}")
            member.size = len(text.encode())
            archive.addfile(member, io.BytesIO(text.encode()))
    return f"{name}-{version}.tar.gz", packed.getvalue()


def repacked(name: str) -> tuple[str, bytes]:
    """The wheel of a package that is installed here."""
    there = distribution(name)
    files, scripts = {}, {}
    for path in there.files or ():
        if path.suffix == ".pyc" or ".dist-info" in str(path):
            continue
        data = Path(str(path.locate())).read_bytes()
        if path.parts[-2:-1] == ("bin",):
            scripts[path.name] = data
        else:
            files[str(path)] = data
    return wheel(name, there.version, files, scripts=scripts)


class Index:
    """A package index on this machine: `files` holds what each package offers."""

    def __init__(self) -> None:
        self.files: dict[str, dict[str, bytes]] = {}
        self.yanked: set[str] = set()
        index = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                *_, package, file = self.path.split("/")
                found = index.files.get(package, {})
                answer = found.get(file) if file else index.page(found)
                if not found or answer is None:
                    self.send_error(404)
                    return
                self.send_response(200)
                kind = "application/octet-stream" if file else "text/html"
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}/simple"
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    def page(self, files: Mapping[str, bytes]) -> bytes:
        links = (
            f'<a href="{file}#sha256={hashlib.sha256(data).hexdigest()}"'
            f"{' data-yanked' if file in self.yanked else ''}>{file}</a>\n"
            for file, data in files.items()
        )
        return f"<!DOCTYPE html><html><body>\n{''.join(links)}</body></html>".encode()

    def offer(self, file: tuple[str, bytes], *, yanked: bool = False) -> str:
        """Put a file on the index, and return its line in a lock."""
        stem, data = file
        name, version = stem.removesuffix(".tar.gz").split("-")[:2]
        name = name.replace("_", "-")
        self.files.setdefault(name, {})[stem] = data
        if yanked:
            self.yanked.add(stem)
        return f"{name}=={version} --hash=sha256:{hashlib.sha256(data).hexdigest()}\n"

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@pytest.fixture
def index() -> Iterator[Index]:
    made = Index()
    yield made
    made.close()


LOCKED = {
    "setuptools": "1.0",
    "colcon-core": "1.0",
    "asked-with-extra": "1.0",
    "of-the-extra": "1.0",
    "numba": "1.0",
    "rclpy": "1.0",
    "empy": "1.0",
    "withdrawn": "1.0",
    "checker": "1.0",
    "packaging": distribution("packaging").version,
}


@pytest.fixture
def workspace(tmp_path: Path, index: Index) -> Path:
    """A workspace whose locks hold a few packages, each of which is there in a worse version."""
    folder = tmp_path / "workspace"
    shutil.copytree(ROOT / "tools", folder / "tools")
    locks = dict.fromkeys(("installer", "seed", "run", "ros", "dev"), "")

    def lock(where: str, file: tuple[str, bytes], **how: bool) -> None:
        locks[where] += index.offer(file, **how)

    module = b"version = 1\n"
    lock("seed", wheel("setuptools", "1.0", {"setuptools/__init__.py": module}))
    # What failed once: asked for with an extra, the newest release was looked at.
    needs = "Requires-Dist: asked-with-extra[extra]>=1.0\n"
    lock("run", wheel("colcon-core", "1.0", {"colcon_core.py": module}, needs))
    extra = "Provides-Extra: extra\nRequires-Dist: of-the-extra; extra == 'extra'\n"
    lock("run", wheel("asked-with-extra", "1.0", {"asked.py": module}, extra))
    lock("run", wheel("of-the-extra", "1.0", {"of_the_extra.py": module}))
    lock("run", wheel("numba", "1.0", {"numba.py": module}))
    lock("run", source("empy", "1.0"))
    lock("run", wheel("withdrawn", "1.0", {"withdrawn.py": module}), yanked=True)
    lock("run", repacked("packaging"))
    lock("ros", wheel("rclpy", "1.0", {"rclpy.py": module}))
    lock("dev", wheel("checker", "1.0", {"checker.py": module}))

    poison = {"poison.py": b"raise SystemExit('poisoned')\n"}
    for name in LOCKED:
        index.offer(wheel(name, "99.0", poison, extra if name == "asked-with-extra" else ""))
    index.offer(wheel("of-the-extra", "99.1", poison, tag="py2-none-any"))  # none for this Python
    index.offer(source("numba", "99.1", tmp_path / "poisoned"))  # no wheel at all
    index.offer(wheel("rclpy", "99.1", poison), yanked=True)
    # The locked version itself, once more: another file, which an index may prefer.
    index.offer(wheel("checker", "1.0", poison, tag="1-py3-none-any"))
    index.offer(source("withdrawn", "1.0", tmp_path / "poisoned"))
    (folder / "requirements").mkdir()
    for name, text in locks.items():
        (folder / f"requirements/{name}.txt").write_text(text)
    return folder


def set_up(folder: Path, *parts: str, **variables: str) -> subprocess.CompletedProcess[str]:
    home = folder.parent / "home"
    home.mkdir(exist_ok=True)
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(home), **variables}
    return subprocess.run(
        [PYTHON, folder / "tools/set_up.py", *parts],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )


def installed(folder: Path) -> dict[str, str]:
    """Name and version of what is in the environment of a workspace."""
    (packages,) = folder.glob(".venv/lib/python*/site-packages")
    found = (path.name.removesuffix(".dist-info") for path in packages.glob("*.dist-info"))
    pairs = (name.split("-") for name in found)
    return {name.replace("_", "-"): version for name, version in pairs if name != "pip"}


# The tests ------------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["uv", "pip"])
def test_nothing_but_the_lock_is_installed(workspace, index, tmp_path, by):
    lock = workspace / "requirements/installer.txt"
    lock.write_text(index.offer(repacked("uv")) if by == "uv" else index.offer(source("uv", "1.0")))
    done = set_up(workspace, "environment", PIP_INDEX_URL=index.url)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("by pip" in done.stdout) == (by == "pip"), done.stdout
    assert installed(workspace) == {k: v for k, v in LOCKED.items() if k != "checker"}
    assert not (tmp_path / "poisoned").exists()

    # The same again for what comes on top, in a shell full of settings for something else; the
    # index is now named in the user's file.
    lock.write_text(index.offer(source("uv", "1.0")))
    file = tmp_path / "home/pip.conf"
    file.write_text(
        f"[global]\nindex-url = {index.url}\nno-index = false\nuser = true\npre = true\n"
        f"[install]\ntarget = {tmp_path}/elsewhere\nupgrade = true\n"
    )
    others = tmp_path / "constraints.txt"
    others.write_text("checker==99.0\n")
    done = set_up(
        workspace,
        *("environment", "development"),
        PIP_CONFIG_FILE=str(file),
        PIP_USER="1",
        PIP_PREFIX=f"{tmp_path}/elsewhere",
        PIP_TARGET=f"{tmp_path}/elsewhere",
        PIP_REQUIRE_VIRTUALENV="1",
        PIP_CONSTRAINT=str(others),
        PIP_NO_BINARY=":all:",
        PYTHONOPTIMIZE="2",
        PYTHONUSERBASE=f"{tmp_path}/elsewhere",
        UV_CONSTRAINT=str(others),
        UV_SYSTEM_PYTHON="1",
        UV_INDEX_URL="http://127.0.0.1:9/nothing",
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "venv" not in done.stdout  # the environment was kept
    assert installed(workspace) == LOCKED
    assert not (tmp_path / "poisoned").exists()
    assert not (tmp_path / "elsewhere").exists()

    # Killed in the middle, an installer leaves a package that is described and not whole.
    lock.write_text(index.offer(repacked("uv")) if by == "uv" else index.offer(source("uv", "1.0")))
    (workspace / ".venv/.development-complete").unlink()
    (module,) = workspace.glob(".venv/lib/python*/site-packages/checker.py")
    module.unlink()
    done = set_up(workspace, "development", PIP_INDEX_URL=index.url)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("by pip" in done.stdout) == (by == "pip"), done.stdout
    assert module.exists()


def test_an_incomplete_lock_is_found_out(workspace, index):
    run = workspace / "requirements/run.txt"
    kept = [line for line in run.read_text().splitlines(True) if "of-the-extra" not in line]
    run.write_text("".join(kept))
    done = set_up(workspace, "environment", PIP_INDEX_URL=index.url)
    assert done.returncode == 1
    assert "asked-with-extra requires of-the-extra" in done.stdout
    assert "the step 'check' failed" in done.stderr
    assert not (workspace / ".venv/.complete").exists()


@pytest.fixture(scope="module")
def venv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment in which nothing is installed."""
    folder = tmp_path_factory.mktemp("venv")
    subprocess.run([PYTHON, "-m", "venv", folder], check=True, timeout=PATIENCE)
    return folder


@contextmanager
def installer(venv: Path, workspace: Path, **variables: str) -> Iterator[Any]:
    """The set-up's installer, for an environment."""
    with pytest.MonkeyPatch.context() as patch, (workspace / "lock").open("w") as lock:
        patch.syspath_prepend(str(ROOT / "tools"))
        steps = import_module("steps").Steps(workspace, lock)
        shell = {"PATH": os.environ["PATH"], "HOME": str(workspace), **variables}
        uv = workspace / "requirements/installer.txt"
        with import_module("installer").Installer(venv, uv, steps, shell) as made:
            yield made


@pytest.mark.parametrize("by", ["uv", "pip"])
def test_what_was_changed_on_the_way_is_refused(workspace, index, venv, by):
    index.files["numba"] = dict([wheel("numba", "1.0", {"numba.py": b"evil = True\n"})])
    uv = repacked("uv") if by == "uv" else source("uv", "1.0")
    (workspace / "requirements/installer.txt").write_text(index.offer(uv))
    with installer(venv, workspace, PIP_INDEX_URL=index.url) as made:
        with pytest.raises(Exception, match="the step 'run, by pip' failed") as caught:
            made.install("run", workspace / "requirements/run.txt")
    assert "numba" in caught.value.output
    assert not list(venv.glob("lib/python*/site-packages/numba*"))


def test_no_way_to_an_index_is_told_in_a_sentence(workspace, index, venv):
    (workspace / "requirements/installer.txt").write_text(index.offer(source("uv", "1.0")))
    nowhere = "http://user:word@127.0.0.1:9/x"
    with pytest.raises(Exception, match=r"no package index could be reached \(127.0.0.1\)"):
        with installer(venv, workspace, PIP_INDEX_URL=nowhere, PIP_RETRIES="1"):
            pass


def test_without_a_place_for_what_is_fetched_nothing_is_kept(monkeypatch, tmp_path):
    """Below /proc not even root can make a folder, though it may write there."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    variables = import_module("installer")._installer_variables
    off = {"UV_NO_CACHE": "1", "PIP_NO_CACHE_DIR": "1"}
    nowhere = {"XDG_CACHE_HOME": "/proc/nohome/.cache"}
    assert off.items() <= variables({}, nowhere).items()
    for shell in ({"XDG_CACHE_HOME": str(tmp_path)}, {**nowhere, "UV_CACHE_DIR": str(tmp_path)}):
        assert ("UV_NO_CACHE" in variables({}, shell)) is False
    assert "PIP_NO_CACHE_DIR" in variables({}, shell)


def test_settings_of_the_way_to_an_index_reach_both_installers(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    tool = import_module("installer")
    file = tmp_path / "pip.conf"
    file.write_text(
        "[global]\nindex-url = https://user:word@mirror.example/simple\nuser = true\n"
        "extra-index-url =\n    https://one.example/simple\n    https://two.example/simple\n"
        "trusted-host = mirror.example\n[install]\nfind-links = /wheels /more\n"
    )
    shell = {
        "PATH": os.environ["PATH"],
        "PIP_CONFIG_FILE": str(file),
        "PIP_CERT": "/etc/company.pem",
        "PIP_PROXY": "http://proxy.example:3128",
        "PIP_USER": "1",
        "UV_CONSTRAINT": "/x",
        "UV_CACHE_DIR": "/cache",
    }
    settings = tool._index_settings(Path(sys.executable), shell)
    variables = tool._installer_variables(settings, shell)
    both = {
        ("PIP_INDEX_URL", "UV_DEFAULT_INDEX"): "https://user:word@mirror.example/simple",
        ("PIP_EXTRA_INDEX_URL", "UV_INDEX"): (
            "https://one.example/simple https://two.example/simple"
        ),
        ("PIP_TRUSTED_HOST", "UV_INSECURE_HOST"): "mirror.example",
        ("PIP_FIND_LINKS",): "/wheels /more",
        ("UV_FIND_LINKS",): "/wheels,/more",
        ("PIP_CERT", "SSL_CERT_FILE"): "/etc/company.pem",
        ("PIP_PROXY", "HTTPS_PROXY", "HTTP_PROXY"): "http://proxy.example:3128",
        ("UV_CACHE_DIR",): "/cache",
        ("PIP_CONFIG_FILE",): os.devnull,
    }
    for names, value in both.items():
        for name in names:
            assert variables[name] == value, name
    assert not {"PIP_USER", "UV_CONSTRAINT"} & variables.keys()
    assert tool._index_of(settings) == "mirror.example"  # no password in a message
