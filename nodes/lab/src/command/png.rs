//! `consort-lab png`: converts a drawing to an image.

use crate::png::png;
use consort_nodes::exit::Failure;
use std::io::Read as _;
use std::path::PathBuf;

/// Convert an SVG to a PNG
///
/// Reads the SVG from the standard input. The font is embedded, so the image is the same on every
/// machine. `consort map show --out FILE.png` calls this command.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort map show hospital --out - | consort-lab png hospital.png")]
pub(crate) struct Args {
    /// The file to write
    #[arg(value_name = "FILE")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if the input is not SVG, or the file cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let failed = |problem: String| Failure::Unsuccessful(problem);
    let mut svg = String::new();
    std::io::stdin()
        .read_to_string(&mut svg)
        .map_err(|problem| failed(format!("the standard input cannot be read: {problem}")))?;
    let image = png(&svg).map_err(|problem| failed(problem.to_string()))?;
    std::fs::write(&args.out, image)
        .map_err(|problem| failed(format!("{} cannot be written: {problem}", args.out.display())))
}
