//! The binary: names its allocator and hands the command line to [`celld::cli`].

/// Takes no lock for a block, except now and then for a new part of memory. The C library's allocator takes
/// one each time: on a busy computer the control loop and the readers of orders waited up to 0.2 s for a
/// thread of low priority that had lost the processor while it held that lock.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    celld::cli::main()
}
