//! The binary of Consort; see `consort --help`.

/// Nodes and virtual fleets allocate many small messages.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    consort_nodes::cli::run()
}
