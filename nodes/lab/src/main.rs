//! The binary of the laboratory; see `consort-lab --help`.

/// Virtual fleets allocate many small messages.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    consort_lab::cli::run()
}
