"""The OCI image: read by skopeo, complete without anything else, the same for the same program.

In: the layout of `make image` (CELLD_IMAGE), the program in it (CELLD_STATIC) and the version
(CELLD_VERSION), from the Makefile. The image's files are run as an engine would run them, with nothing else
in reach: as root by chroot, which needs no engine.
"""

import hashlib
import json
import os
import socket
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

IMAGE = Path(os.environ["CELLD_IMAGE"])
PROGRAM = Path(os.environ["CELLD_STATIC"])
VERSION = os.environ["CELLD_VERSION"]
WRITER = Path(__file__).parents[2] / "packages" / "image" / "write.py"


def skopeo(*arguments):
    """What skopeo prints."""
    done = subprocess.run(["skopeo", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def write(program, folder, version=VERSION):
    """Another image."""
    command = [sys.executable, str(WRITER), str(program), version, "86400", str(folder)]
    return subprocess.run(command, capture_output=True, text=True)


def contents(folder):
    """Every file below a folder with its bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """The files of the image as skopeo hands them on."""
    folder = tmp_path_factory.mktemp("image")
    skopeo("copy", "--quiet", f"oci:{IMAGE}:{VERSION}", f"dir:{folder / 'copy'}")
    manifest = json.loads((folder / "copy" / "manifest.json").read_text())
    for layer in manifest["layers"]:
        blob = folder / "copy" / layer["digest"].removeprefix("sha256:")
        assert hashlib.sha256(blob.read_bytes()).hexdigest() == blob.name
        with tarfile.open(blob) as tar:
            tar.extractall(folder / "root")
    return folder / "root"


def test_skopeo_reads_what_the_image_is():
    seen = json.loads(skopeo("inspect", f"oci:{IMAGE}:{VERSION}"))
    assert (seen["Os"], seen["Architecture"]) in [("linux", "amd64"), ("linux", "arm64")]
    assert seen["Labels"]["org.opencontainers.image.version"] == VERSION
    config = json.loads(skopeo("inspect", "--config", f"oci:{IMAGE}:{VERSION}"))["config"]
    assert config["Entrypoint"] == ["/celld-sim", "--bind", "0.0.0.0"]
    assert {"29999/tcp", "30001/tcp", "30004/tcp", "5020/tcp"} <= set(config["ExposedPorts"])
    assert config["User"] == "65532:65532"


def test_docker_s_own_archive_can_be_made_of_it(tmp_path):
    archive = tmp_path / "celld-sim.tar"
    skopeo("copy", "--quiet", f"oci:{IMAGE}:{VERSION}", f"docker-archive:{archive}:celld-sim:{VERSION}")
    seen = json.loads(skopeo("inspect", f"docker-archive:{archive}"))
    assert len(seen["Layers"]) == 1


def test_nothing_is_in_it_but_the_program_an_account_and_licences(unpacked):
    files = set(contents(unpacked))
    assert files == {"celld-sim", "etc/passwd", "etc/group", "licenses/LICENSE-APACHE", "licenses/LICENSE-MIT"}
    assert (unpacked / "celld-sim").read_bytes() == PROGRAM.read_bytes()


def test_the_same_program_gives_the_same_image_and_another_another(tmp_path):
    for name in ("first", "second"):
        assert write(PROGRAM, tmp_path / name).returncode == 0
    assert contents(tmp_path / "first") == contents(tmp_path / "second")
    assert write(PROGRAM, tmp_path / "third", version="9.9.9").returncode == 0
    assert contents(tmp_path / "first") != contents(tmp_path / "third")


def test_a_script_is_no_program_for_an_image(tmp_path):
    refused = write(WRITER, tmp_path / "none")
    assert refused.returncode != 0 and "not a program for amd64" in refused.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="chroot needs root")
def test_its_entrypoint_runs_with_nothing_but_the_image(unpacked):
    config = json.loads(skopeo("inspect", "--config", f"oci:{IMAGE}:{VERSION}"))["config"]
    # Here the network is the computer's: an address and ports of its own, the last of each option counts.
    own = ["--bind", "127.63.2.1"]
    command = ["chroot", f"--userspec={config['User']}", str(unpacked), *config["Entrypoint"], *own]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        line = running.stdout.readline()
        assert line, running.stderr.read()
        assert json.loads(line)["bind"] == "127.63.2.1"
        with socket.create_connection(("127.63.2.1", 29999), timeout=30) as dashboard:
            assert b"Universal Robots Dashboard Server" in dashboard.recv(100)
        # As an engine ends it.
        running.terminate()
        assert running.wait(30) == 0


def test_a_program_that_needs_libraries_or_is_too_large_is_not_static():
    check = str(WRITER.parents[1] / "static.sh")
    for program, most, words in [("/bin/true", "15", "shared libraries"), (str(PROGRAM), "1", "more than 1 MB")]:
        refused = subprocess.run([check, program, most], capture_output=True, text=True)
        assert refused.returncode == 1 and words in refused.stderr


def test_the_shell_lines_of_the_page_run(tmp_path):
    page = (WRITER.parents[2] / "docs" / "simulator.md").read_text()
    block = page.split("Any shell, with")[1].split("\n\n")[1]
    lines = [line.strip() for line in block.splitlines()]
    assert lines[0].startswith("vendor/celld-sim ") and lines[-1] == "./your-tests --robot 127.0.0.2"
    (tmp_path / "vendor").mkdir()
    (tmp_path / "vendor" / "celld-sim").symlink_to(PROGRAM)
    tests = tmp_path / "your-tests"
    tests.write_text("#!/bin/bash\nexec 3<>/dev/tcp/$2/29999 && head -n 1 <&3\n")
    tests.chmod(0o755)
    # Another address: that of the page is the one that people use by hand.
    script = "\n".join(["set -euo pipefail", *lines]).replace("127.0.0.2", "127.63.2.2")
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "Universal Robots Dashboard Server" in done.stdout, done.stderr
