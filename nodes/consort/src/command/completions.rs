//! `consort completions` and `consort man`: shell completions and manual pages, from the same
//! source as `--help`.

use crate::exit::Failure;
use crate::output;
use clap::Command;
use clap_complete::Shell;
use std::path::PathBuf;

/// Print the completion script of a shell
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort completions bash > ~/.local/share/bash-completion/completions/consort
  consort completions zsh  > ~/.zfunc/_consort
  consort completions fish > ~/.config/fish/completions/consort.fish")]
pub(crate) struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write manual pages: for the program and for each of its commands
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort man /usr/local/share/man/man1 && man consort-submit")]
pub(crate) struct ManArgs {
    /// The folder, created if it does not exist
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

/// Prints completions of a program.
///
/// # Errors
/// [`Failure::OutputClosed`].
pub(crate) fn run(args: &Args, mut program: Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "consort", &mut script);
    output::line(String::from_utf8_lossy(&script).trim_end())
}

/// Writes manual pages of a program.
///
/// # Errors
/// [`Failure::Usage`] if they cannot be written.
pub(crate) fn man(args: &ManArgs, program: Command) -> Result<(), Failure> {
    let failed = |problem: std::io::Error| Failure::Usage(format!("{}: {problem}", args.dir.display()));
    std::fs::create_dir_all(&args.dir).map_err(failed)?;
    clap_mangen::generate_to(program, &args.dir).map_err(failed)?;
    output::line(format_args!("written to {}", args.dir.display()))
}
