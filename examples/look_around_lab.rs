//! The laboratory with the skill of `look_around.rs`.

#[path = "look_around.rs"]
#[expect(dead_code, reason = "the program is another one")]
mod look_around;

fn main() -> std::process::ExitCode {
    consort_lab::cli::run_with(look_around::EXTENSIONS, std::env::args_os())
}
