//! `consort map`: draws, checks and converts maps.

use super::drawn_world;
use super::flag_values::InvalidValue;
use crate::config::to_toml;
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::exit::Failure;
use crate::{lab_program, map_loader, output};
use consort_map_import::{Drawing, ImportOptions};
use consort_text::count;
use consort_world::map::{self, Map, render};
use std::ffi::OsStr;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;

/// Draw, check and convert maps
///
/// Reads maps in Consort's own format (YAML, JSON), drawings of diagrams.net by the conventions of
/// HMR Sim (`.drawio`, `.xml`), buildings of Open-RMF (`.building.yaml`) and layouts in the Layout
/// Interchange Format of VDMA (`.lif`, `.lif.json`), detected by the file's extension. The same
/// files are accepted wherever a map is configured: `map = "…"` in a fleet or
/// world file, and `--map`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort map show hospital --out hospital.svg
  consort map show ward.drawio                      # draws ward.svg
  consort map show ward.drawio --out - | display    # to the standard output
  consort map check ward.drawio office.building.yaml
  consort map convert ward.drawio --scale 0.05 --out ward.yaml
  consort map convert office.building.yaml --graph 1 --out office.yaml
  consort map convert ward.drawio --out ward.yaml --world ward.toml && consort world --config ward.toml

A drawing (.drawio, .xml): shapes of type `POI` are places, named by `tag`, and lines of type `map-path` are lanes; `robot`,
`pickable` and `person` are robots, objects and people; floor-plan shapes are walls. Each page is a level. A unit is 0.02 m
unless the page (`metres_per_unit` in *Edit Data* with nothing selected) or --scale sets it.

A building (.building.yaml): vertices at lanes are places. The length of a pixel follows from the level's measurements, unless
--scale sets it. Lanes of all navigation graphs are read, unless --graph selects one; a robot's file names its graph.

A layout (.lif, .lif.json): nodes are places, edges are lanes, types of vehicles are navigation graphs.")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Draw a map, as SVG or PNG
    ///
    /// Draws places by their kind, lanes with their directions and limits, doors, lifts and walls,
    /// a panel for each level, and the drawn robots, objects and people. An SVG shows details under
    /// the pointer.
    Show {
        #[command(flatten)]
        source: Source,
        /// The image: PNG if the name ends in `.png`, else SVG; `-` is the standard output. A PNG
        /// needs `consort-lab`.
        /// Default: the map's file name with `.svg`, in the current directory
        #[arg(long, value_name = "PICTURE")]
        out: Option<PathBuf>,
    },
    /// Check maps and list their content
    ///
    /// Prints `ok` and the content, with a note for everything that was left out or assumed, and for
    /// each dead end in which robots cannot pass each other; or each problem with file, position and
    /// allowed values: also places that cannot be reached, or that have no way back.
    Check {
        /// The map files, or names of bundled maps
        #[arg(required = true, value_name = "FILE")]
        files: Vec<PathBuf>,
        #[command(flatten)]
        reading: Reading,
    },
    /// Write a map in another format
    ///
    /// Parts that Consort's format does not hold (robots, objects, people) are reported on the
    /// standard error, or written to a world file.
    Convert {
        #[command(flatten)]
        source: Source,
        /// The format to write
        #[arg(long, value_enum, default_value_t = Form::Ours)]
        to: Form,
        /// The output file: JSON if the name ends in `.json`, else YAML. Default: the standard
        /// output
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Write a world file too, with the drawn robots, people and objects: for `consort world`
        #[arg(long, value_name = "FILE.toml", requires = "out")]
        world: Option<PathBuf>,
    },
}

/// Output formats of maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    /// Consort's own format.
    Ours,
}

#[derive(Debug, clap::Args)]
struct Source {
    /// The map file, or the name of a bundled map
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    reading: Reading,
}

/// Settings for values that a file leaves open.
#[derive(Debug, clap::Args)]
struct Reading {
    /// Metres per unit of a drawing or pixel of a building, instead of the file's value
    #[arg(long, value_name = "METRES", value_parser = scale)]
    scale: Option<f64>,
    /// Read a single navigation graph of an Open-RMF building. Default: all
    #[arg(long, value_name = "NUMBER")]
    graph: Option<i64>,
}

fn scale(text: &str) -> Result<f64, InvalidValue> {
    let scale: Option<f64> = text.parse().ok();
    scale
        .filter(|scale| (1e-6..=1e6).contains(scale))
        .ok_or_else(|| InvalidValue::new("allowed is a number from 0.000001 to 1000000"))
}

impl Reading {
    fn read(&self, file: &Path) -> Result<(Drawing, Map), Diagnostics> {
        let name = file.to_string_lossy();
        if map_loader::is_shipped(&name) {
            let wrong = |error| map_loader::diagnostics(&name, error);
            return Ok((map::shipped_file(&name).map_err(wrong)?.into(), map::shipped(&name).map_err(wrong)?));
        }
        let text = map_loader::read_text(&name)?;
        if map_loader::is_published_format(&text) {
            let what =
                "this map has the published format, which has routes but no floor plan: there is nothing to draw";
            return Err(Diagnostic::for_file(&name, what).into());
        }
        let options = ImportOptions { scale_m: self.scale, graph: self.graph };
        let drawing =
            consort_map_import::parse(&text, &name, &options).map_err(|error| map_loader::diagnostics(&name, error))?;
        let map = drawing.map.check(&name).map_err(|error| map_loader::diagnostics(&name, error))?;
        Ok((drawing, map))
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a map that cannot be read or is not valid, [`Failure::Unsuccessful`] if a
/// check finds problems or a file cannot be written.
pub fn run(args: Args) -> Result<(), Failure> {
    match args.what {
        What::Show { source, out } => draw(&source, out),
        What::Check { files, reading } => check(&files, &reading),
        What::Convert { source, to: Form::Ours, out, world } => convert(&source, out.as_deref(), world.as_deref()),
    }
}

fn draw(source: &Source, out: Option<PathBuf>) -> Result<(), Failure> {
    let (drawing, map) = source.reading.read(&source.file)?;
    notes(&source.file, &drawing);
    let svg = render::svg(&map, &drawing.items().collect::<Vec<_>>());
    let out = out.unwrap_or_else(|| picture_of(&source.file));
    if out.as_os_str() == "-" {
        return output::line(svg);
    }
    if ends_in(&out, "png") {
        write_png(&out, &svg)?;
    } else {
        write(&out, svg.as_bytes())?;
    }
    output::line(format_args!("{}: {}", out.display(), contents(&drawing, &map)))
}

/// Converts a drawing with `consort-lab`, which contains a rasterizer.
fn write_png(out: &Path, svg: &str) -> Result<(), Failure> {
    let mut lab = lab_program::command([OsStr::new("png"), out.as_os_str()]);
    let mut lab = lab.stdin(Stdio::piped()).spawn().map_err(|problem| lab_program::not_started(&problem))?;
    // If the program fails early, its exit status and its message tell more than the broken pipe.
    let _ = lab.stdin.take().expect("it is piped").write_all(svg.as_bytes());
    let status = lab.wait().map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
    match status.success() {
        true => Ok(()),
        false => Err(Failure::Unsuccessful(format!("{} was not written", out.display()))),
    }
}

/// Returns the default image file: `ward.svg` for `maps/ward.drawio`, `office.svg` for
/// `office.building.yaml`.
fn picture_of(file: &Path) -> PathBuf {
    let stem = file.file_stem().unwrap_or(file.as_os_str()).to_string_lossy();
    PathBuf::from(format!("{}.svg", stem.strip_suffix(".building").unwrap_or(&stem)))
}

fn check(files: &[PathBuf], reading: &Reading) -> Result<(), Failure> {
    let mut wrong = 0;
    for file in files {
        match reading.read(file) {
            Ok((drawing, map)) => {
                for note in &drawing.notes {
                    output::line(format_args!("{}: note: {note}", file.display()))?;
                }
                for dead_end in map.dead_ends() {
                    output::line(format_args!("{}: note: {dead_end}", file.display()))?;
                }
                output::line(format_args!("{}: ok, {}", file.display(), contents(&drawing, &map)))?;
            }
            Err(problems) => {
                wrong += 1;
                output::line(problems)?;
            }
        }
    }
    match wrong {
        0 => Ok(()),
        _ => Err(Failure::Unsuccessful(format!("problems in {wrong} of {}", count(files.len(), "map", "maps")))),
    }
}

fn convert(source: &Source, out: Option<&Path>, world: Option<&Path>) -> Result<(), Failure> {
    let (drawing, _) = source.reading.read(&source.file)?;
    notes(&source.file, &drawing);
    for item in drawing.items().filter(|_| world.is_none()) {
        let near = item.place.as_ref().map_or_else(String::new, |place| format!(", near {place:?}"));
        let (x, y) = (item.x_m, item.y_m);
        let name = source.file.display();
        output::note(format_args!(
            "{name}: note: a map holds no {}: {:?} at ({x}, {y}) m{near} is left out",
            item.kind, item.name
        ));
    }
    let refused = |error: String| Failure::Unsuccessful(format!("this map cannot be written: {error}"));
    let text = if out.is_some_and(|out| ends_in(out, "json")) {
        serde_json::to_string_pretty(&drawing.map).map_err(|error| refused(error.to_string()))?
    } else {
        serde_saphyr::to_string(&drawing.map).map_err(|error| refused(error.to_string()))?
    };
    let text = text.trim_end();
    match out {
        Some(out) => write(out, format!("{text}\n").as_bytes())?,
        None => output::line(text)?,
    }
    match (out, world) {
        (Some(out), Some(world)) => write_world(&source.file, &drawing, out, world),
        _ => Ok(()),
    }
}

/// Writes a world file with the drawn robots, people and objects. The map itself was written to
/// `map`.
fn write_world(source: &Path, drawing: &Drawing, map: &Path, world: &Path) -> Result<(), Failure> {
    // A world file names its map relative to its own folder.
    let beside = map.parent() == world.parent();
    let named = if beside { map.file_name().map(PathBuf::from) } else { std::fs::canonicalize(map).ok() };
    let named = named.unwrap_or_else(|| map.to_owned()).display().to_string();
    let (config, notes) = drawn_world::world_from_drawing(drawing, named);
    for note in notes {
        output::note(format_args!("{}: note: {note}", source.display()));
    }
    write(world, to_toml(&config).as_bytes())
}

fn notes(file: &Path, drawing: &Drawing) {
    for note in &drawing.notes {
        output::note(format_args!("{}: note: {note}", file.display()));
    }
}

fn ends_in(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes)
        .map_err(|error| Failure::Unsuccessful(format!("{} cannot be written: {error}", path.display())))
}

fn contents(drawing: &Drawing, map: &Map) -> String {
    let counts = [
        (map.levels().len(), "level", "levels"),
        (map.places().len(), "place", "places"),
        (map.lanes().len(), "lane", "lanes"),
        (map.doors().len(), "door", "doors"),
        (map.lifts().len(), "lift", "lifts"),
        (drawing.robots.len(), "robot", "robots"),
        (drawing.objects.len(), "object", "objects"),
        (drawing.people.len(), "person", "people"),
        (drawing.others.len(), "other thing", "other things"),
    ];
    let described = counts.iter().filter(|(number, ..)| *number > 0);
    let described = described.map(|(number, singular, plural)| count(*number, singular, plural));
    format!("{}: {}", map.name(), described.collect::<Vec<_>>().join(", "))
}
