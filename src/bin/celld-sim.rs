//! The simulator alone: `celld sim` under a name of its own. It uses no OpenCV, so the linker leaves out the
//! two hundred libraries behind it, and it starts in milliseconds; that is what makes it worth having in
//! other people's tests.

fn main() -> std::process::ExitCode {
    celld::cli::simulator()
}
