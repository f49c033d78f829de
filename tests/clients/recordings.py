"""Recordings of celld in other programs: the MCAP project's reader, Foxglove's published schemas.

In: a folder with `whole.mcap`, `cut.mcap` (the writer was killed) and `repaired.mcap`; `small.mcap`, `cuts`
and `repaired` with the same file cut anywhere, and these repaired. Out: a line for each check; the exit code
is 1 when one failed.
"""

import os
import sys

import foxglove.messages as published
from harness import check, finish
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

FOLDER = sys.argv[1]


def path(name):
    """A file of the folder."""
    return os.path.join(FOLDER, name)


def messages(name):
    """All messages in the reader's default order, as (topic, log time, bytes)."""
    with open(path(name), "rb") as stream:
        found = make_reader(stream).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in found]


def streamed(name):
    """Messages of the chunks that can be read from the beginning on."""
    count = 0
    with open(path(name), "rb") as stream:
        try:
            for record in StreamReader(stream).records:
                count += type(record).__name__ == "Message"
        except Exception:  # The file breaks off: whatever the reader says then.
            pass
    return count


def schemas():
    """Each schema of Foxglove's in the file equals the published one."""
    with open(path("whole.mcap"), "rb") as stream:
        summary = make_reader(stream).get_summary()
    names = set()
    for schema in summary.schemas.values():
        if not schema.name.startswith("foxglove."):
            check(f"{schema.name} is celld's own", schema.name.startswith("celld."))
            continue
        name = schema.name.removeprefix("foxglove.")
        names.add(name)
        theirs = getattr(published, name).get_schema()
        same = (schema.encoding, schema.data) == (theirs.encoding, bytes(theirs.data))
        check(f"{schema.name} is the published schema", same)
    wanted = {"FrameTransforms", "SceneUpdate", "CompressedImage", "CameraCalibration", "JointStates", "Log"}
    check("the file has all schemas that the page on recordings names", names == wanted, f"{names}")


def cut_anywhere():
    """Of a file cut anywhere the streaming reader finds every finished chunk, the default one the same."""
    small = messages("small.mcap")
    known = set(small)
    names = sorted(os.listdir(path("cuts")))
    check("there are a thousand cut files", len(names) == 1000, f"{len(names)}")
    differ = []
    found = 0
    for name in names:
        finished = streamed(os.path.join("cuts", name))
        repaired = messages(os.path.join("repaired", name))
        found += finished
        if len(repaired) != finished or not set(repaired) <= known:
            differ.append(f"{name}: {finished} streamed, {len(repaired)} after repair")
    check("cut anywhere, repaired files hold the finished chunks", not differ, "; ".join(differ[:5]))
    check("of which there are many", found > 100 * len(small), f"{found} of {len(small)} messages a file")


def main():
    """All checks."""
    schemas()
    whole = messages("whole.mcap")
    check("the whole file is read", len(whole) > 20, f"{len(whole)} messages")
    check("in the order of time", [m[1] for m in whole] == sorted(m[1] for m in whole))
    pictures = [data for topic, _, data in whole if topic == "/camera/image"]
    check("pictures are JPEG", pictures and all(b"\xff\xd8\xff" in data[:64] for data in pictures))
    finished = streamed("cut.mcap")
    check("of the cut file every finished chunk is streamed", 0 < finished < len(whole), f"{finished}")
    repaired = messages("repaired.mcap")
    check("after repair the default reader finds the same", len(repaired) == finished, f"{len(repaired)}")
    check("and nothing else", set(repaired) <= set(whole))
    cut_anywhere()
    finish()


main()
