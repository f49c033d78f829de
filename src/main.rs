//! The binary: hands the command line to [`celld::cli`] and nothing else.

fn main() -> std::process::ExitCode {
    celld::cli::main()
}
