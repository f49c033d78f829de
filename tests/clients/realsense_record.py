"""Records what a made-up RealSense camera sends: colour, depth from a second viewpoint, a distorted lens.

In: the file to write (.db3). Out: that file, made by the SDK's own recorder. The Rust tests compare what
celld reads with the numbers below (src/io/camera/realsense/tests.rs has the same ones).
"""

import sys

import pyrealsense2 as rs

WIDTH, HEIGHT, FRAMES, UNIT_M = 64, 48, 12, 0.0001


def stream(kind, fmt, uid, bpp):
    """A stream with a lens of 60 px focal length; the colour stream's is distorted."""
    lens = rs.intrinsics()
    lens.width, lens.height = WIDTH, HEIGHT
    lens.fx, lens.fy, lens.ppx, lens.ppy = 60.0, 60.0, 31.5, 23.5
    colour = kind == rs.stream.color
    lens.model = rs.distortion.inverse_brown_conrady if colour else rs.distortion.none
    lens.coeffs = [-0.05, 0.06, 0.0, 0.0, -0.01] if colour else [0.0] * 5
    made = rs.video_stream()
    made.type, made.fmt, made.index, made.uid = kind, fmt, 0, uid
    made.width, made.height, made.fps, made.bpp = WIDTH, HEIGHT, 30, bpp
    made.intrinsics = lens
    return made


def frame(profile, bpp, number, pixels):
    """One picture of a stream."""
    made = rs.software_video_frame()
    made.pixels, made.bpp, made.stride = pixels, bpp, WIDTH * bpp
    made.timestamp, made.frame_number = 1000.0 + number * 33.0, number
    made.domain, made.profile = rs.timestamp_domain.hardware_clock, profile
    return made


def colour_pixels(number):
    """Red grows to the right, green downwards, blue with the frame."""
    pixels = bytearray()
    for y in range(HEIGHT):
        for x in range(WIDTH):
            pixels += bytes((3 * x, 4 * y, 10 * number))
    return pixels


def depth_pixels():
    """A wall at 0.6 m, the left half of it not measured."""
    pixels = bytearray()
    for _ in range(HEIGHT):
        for x in range(WIDTH):
            units = 6000 if x >= WIDTH // 2 else 0
            pixels += units.to_bytes(2, "little")
    return pixels


def main(path):
    device = rs.software_device()
    device.register_info(rs.camera_info.name, "Intel RealSense D405 (software)")
    device.register_info(rs.camera_info.serial_number, "405405")
    sensor = device.add_sensor("Stereo Module")
    sensor.add_read_only_option(rs.option.depth_units, UNIT_M)
    depth = sensor.add_video_stream(stream(rs.stream.depth, rs.format.z16, 1, 2)).as_video_stream_profile()
    colour = sensor.add_video_stream(stream(rs.stream.color, rs.format.rgb8, 2, 3)).as_video_stream_profile()
    away = rs.extrinsics()
    away.rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]
    # Seen from the colour camera, things are 50 mm further right: 5 pixels at 0.6 m.
    away.translation = [0.05, 0, 0]
    depth.register_extrinsics_to(colour, away)
    recorder = rs.recorder(path, device)
    recording = recorder.query_sensors()[0]
    recording.open([depth, colour])
    recording.start(lambda _: None)
    for number in range(1, FRAMES + 1):
        sensor.on_video_frame(frame(depth, 2, number, depth_pixels()))
        sensor.on_video_frame(frame(colour, 3, number, colour_pixels(number)))
    recording.stop()
    recording.close()


main(sys.argv[1])
