"""Writes an OCI image with celld-sim alone, without a container engine.

In: the statically linked program, its version, the time it is dated, and an empty or new folder. Out: an
OCI image layout in that folder. The same program, version and time give the same bytes: entries are sorted,
belong to root and carry that time. Nothing else is in the image but an account to run as and the licences;
the program opens no TLS connection, so there are no certificates.

    python3 packages/image/write.py PROGRAM VERSION SECONDS FOLDER
"""

import datetime
import gzip
import hashlib
import io
import json
import shutil
import struct
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

MACHINES = {62: "amd64", 183: "arm64"}
"""OCI's names of architectures by their number in an ELF header."""

ACCOUNT = 65532
"""Who the program runs as; it needs no right but to listen at ports above 1023."""

PORTS = [5020, 8090, 29999, 30001, 30002, 30003, 30004, 30011, 30012, 30013, 30020]

FILES = {
    "etc/passwd": f"root:x:0:0:root:/:/none\nsim:x:{ACCOUNT}:{ACCOUNT}:celld-sim:/:/none\n",
    "etc/group": f"root:x:0:\nsim:x:{ACCOUNT}:\n",
}


def main(program, version, seconds, folder):
    """Writes the layout."""
    if folder.exists():
        # An earlier image is written anew; whatever else is there was not meant.
        if any(folder.iterdir()) and not (folder / "oci-layout").is_file():
            sys.exit(f"{folder} has other files in it: name an empty or a new folder")
        shutil.rmtree(folder)
    blobs = folder / "blobs" / "sha256"
    blobs.mkdir(parents=True)
    layer = layer_of(program, seconds)
    packed = gzip.compress(layer, compresslevel=9, mtime=0)
    config = config_of(architecture_of(program), version, seconds, digest(layer))
    manifest = {
        "schemaVersion": 2,
        "mediaType": "application/vnd.oci.image.manifest.v1+json",
        "config": stored(blobs, json_bytes(config), "application/vnd.oci.image.config.v1+json"),
        "layers": [stored(blobs, packed, "application/vnd.oci.image.layer.v1.tar+gzip")],
        "annotations": labels(version, seconds),
    }
    entry = stored(blobs, json_bytes(manifest), "application/vnd.oci.image.manifest.v1+json")
    entry["annotations"] = {"org.opencontainers.image.ref.name": version}
    index = {"schemaVersion": 2, "mediaType": "application/vnd.oci.image.index.v1+json", "manifests": [entry]}
    (folder / "index.json").write_bytes(json_bytes(index))
    (folder / "oci-layout").write_bytes(json_bytes({"imageLayoutVersion": "1.0.0"}))


def layer_of(program, seconds):
    """All files of the image as a tar."""
    files = {name: (text.encode(), 0o644) for name, text in FILES.items()}
    for licence in ("LICENSE-APACHE", "LICENSE-MIT"):
        files[f"licenses/{licence}"] = ((ROOT / licence).read_bytes(), 0o644)
    files["celld-sim"] = (program.read_bytes(), 0o755)
    folders = sorted({str(Path(name).parent) for name in files} - {"."})
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name in folders:
            tar.addfile(entry_of(name, seconds, 0o755, kind=tarfile.DIRTYPE))
        for name, (content, mode) in sorted(files.items()):
            tar.addfile(entry_of(name, seconds, mode, size=len(content)), io.BytesIO(content))
    return out.getvalue()


def entry_of(name, seconds, mode, size=0, kind=tarfile.REGTYPE):
    """A tar entry that depends on nothing else."""
    entry = tarfile.TarInfo(name)
    entry.mtime, entry.mode, entry.size, entry.type = seconds, mode, size, kind
    return entry


def config_of(architecture, version, seconds, layer):
    """What an engine runs: the program on all addresses of the container."""
    return {
        "created": date_of(seconds),
        "architecture": architecture,
        "os": "linux",
        "config": {
            "User": f"{ACCOUNT}:{ACCOUNT}",
            "ExposedPorts": {f"{port}/tcp": {} for port in PORTS},
            "Entrypoint": ["/celld-sim", "--bind", "0.0.0.0"],
            "WorkingDir": "/",
            "Labels": labels(version, seconds),
            "StopSignal": "SIGTERM",
        },
        "rootfs": {"type": "layers", "diff_ids": [layer]},
        "history": [{"created": date_of(seconds), "created_by": "celld: make image"}],
    }


def labels(version, seconds):
    """Names and version by OCI's keys."""
    return {
        "org.opencontainers.image.created": date_of(seconds),
        "org.opencontainers.image.description": "A simulated UR robot behind the controller's own protocols",
        "org.opencontainers.image.licenses": "MIT OR Apache-2.0",
        "org.opencontainers.image.title": "celld-sim",
        "org.opencontainers.image.version": version,
    }


def stored(blobs, content, kind):
    """Keeps a blob; returns its descriptor."""
    name = digest(content)
    (blobs / name.removeprefix("sha256:")).write_bytes(content)
    return {"mediaType": kind, "digest": name, "size": len(content)}


def digest(content):
    """OCI's name of a content."""
    return f"sha256:{hashlib.sha256(content).hexdigest()}"


def json_bytes(value):
    """JSON with sorted keys and no spaces."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def date_of(seconds):
    """A time as RFC 3339 writes it."""
    return datetime.datetime.fromtimestamp(seconds, datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def architecture_of(program):
    """The architecture of an ELF file."""
    header = program.read_bytes()[:20]
    number = struct.unpack_from("<H", header, 18)[0] if header[:4] == b"\x7fELF" else None
    if number not in MACHINES:
        sys.exit(f"{program}: not a program for {' or '.join(MACHINES.values())}")
    return MACHINES[number]


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(f"usage: {sys.argv[0]} PROGRAM VERSION SECONDS FOLDER")
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]))
