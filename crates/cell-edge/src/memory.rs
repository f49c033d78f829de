//! Memory of a process that runs for weeks and handles a picture every few seconds.
//!
//! In: nothing. Out: a setting of the C library's allocator, which serves OpenCV, SQLite and, in
//! `celld-sim`, Rust too. By default it raises the size up to which it allocates blocks in its arenas.
//! Pictures then lie there between small blocks that stay, freed pictures leave holes, and the process
//! grows.

/// Blocks of at least this many bytes are mapped separately and returned to the system when freed. This is
/// also the allocator's initial value.
const LARGE_BLOCK_BYTES: i32 = 128 * 1024;

/// Keeps large blocks out of the arenas from now on. False if the C library cannot do that.
#[cfg(target_env = "gnu")]
#[allow(unsafe_code, reason = "a C interface that takes two numbers")]
pub fn keep_large_blocks_apart() -> bool {
    // SAFETY: takes no pointers, and the C library allows it at any time.
    unsafe { nix::libc::mallopt(nix::libc::M_MMAP_THRESHOLD, LARGE_BLOCK_BYTES) == 1 }
}

/// Keeps large blocks out of the arenas from now on. False if the C library cannot do that.
#[cfg(not(target_env = "gnu"))]
pub fn keep_large_blocks_apart() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes in mappings of their own, as the C library counts them.
    #[cfg(target_env = "gnu")]
    #[allow(unsafe_code, reason = "a C interface without arguments")]
    fn mapped() -> usize {
        // SAFETY: takes nothing and returns numbers.
        unsafe { nix::libc::mallinfo2() }.hblkhd
    }

    #[test]
    #[cfg(target_env = "gnu")]
    fn a_picture_gets_a_mapping_of_its_own_also_after_others_were_freed() {
        let picture = || std::hint::black_box(vec![1u8; 8 << 20]);
        assert!(keep_large_blocks_apart());
        drop(picture());
        let before = mapped();
        let second = picture();
        assert!(mapped() >= before + second.len());
    }
}
