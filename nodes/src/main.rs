//! The one binary of Consort: `consort --help` teaches the rest.

fn main() -> std::process::ExitCode {
    consort_nodes::cli::run()
}
