//! The one binary of Consort: `consort --help` teaches the rest.

fn main() -> std::process::ExitCode {
    std::process::ExitCode::SUCCESS
}
