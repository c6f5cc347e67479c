//! The one binary of Consort: `consort --help` teaches the rest.

/// Nodes and virtual fleets live on small messages.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    consort_nodes::cli::run()
}
