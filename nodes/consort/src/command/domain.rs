//! `consort domain`: writes domain files.

use super::flags::PeopleFlags;
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::exit::Failure;
use crate::{domains, inputs, map_loader, output};
use consort_dashboard::loaded_map::LoadedMap;
use consort_protocol::ids::{DomainId, PlaceId};
use consort_protocol::mission::{
    IhtnNames, IhtnOptions, UndeclaredActions, import_ihtn, is_flat_ihtn, undeclared_actions,
};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain_file::{DomainFile, IhtnForm, scaffold, scaffold_yaml};
use consort_skills::extensions::Extensions;
use consort_world::map::PlaceKind;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Write domain files
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Write a domain for the actions of a mission in the flat iHTN form
    ///
    /// Writes a domain file to the standard output. It declares every action of the file that the
    /// standard domain and the files of --domain lack, or have with other parameters. The simulator
    /// performs these actions in 3 to 6 s each. Locations that the map lacks become rooms of the
    /// map; the file lists them, to be corrected.
    Scaffold(ScaffoldArgs),
}

#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort domain scaffold ihtn.json --person nurse > domain.yaml
  consort demo --virtual --mission ihtn.json --domain domain.yaml")]
struct ScaffoldArgs {
    /// The mission, in the flat iHTN form (JSON)
    #[arg(value_name = "FILE")]
    mission: PathBuf,
    #[command(flatten)]
    people: PeopleFlags,
    /// An agent that is a thing and takes no role; may be repeated
    #[arg(long = "object", value_name = "NAME")]
    objects: Vec<String>,
    /// The map: the name of a bundled map (hospital), or a file
    #[arg(long, env = "CONSORT_MAP", default_value = "hospital", value_name = "NAME|FILE")]
    map: String,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a wrong file, or if the domain does not suffice for it.
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    match args.what {
        What::Scaffold(args) => Ok(output::line(scaffold_domain(&args, extensions)?.trim_end())?),
    }
}

fn scaffold_domain(args: &ScaffoldArgs, extensions: Extensions) -> Result<String, Failure> {
    let path = args.mission.as_path();
    let file = path.display().to_string();
    let text = inputs::read_text(path)?;
    if serde_json::from_str::<Value>(&text).is_ok_and(|value| !is_flat_ihtn(&value)) {
        let what = "this is not a mission in the flat iHTN form, an object of nodes with `type` and `parent`";
        return Err(Diagnostics::from(Diagnostic::for_file(&file, what)).into());
    }
    let in_file = |errors| inputs::mission_diagnostics(&file, &errors);
    let floor = map_loader::load(&args.map)?;
    let options = IhtnOptions { name: inputs::ihtn_name(path), people: args.people.people.iter().cloned().collect() };
    let objects: BTreeSet<String> = args.objects.iter().cloned().collect();
    let names = IhtnNames { objects: objects.clone(), ..IhtnNames::default() };
    let domain = extensions.domain().with_ihtn_names(names);
    let found = undeclared_actions(&text, &options, &domain).map_err(in_file)?;
    if let Some(object) = objects.iter().find(|object| !found.agents.contains(*object)) {
        let agents = found.agents.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        let what = format!("--object {object} is no agent of an action; allowed: {agents}");
        return Err(Diagnostics::from(Diagnostic::for_file(&file, what)).into());
    }
    let places = stand_ins(&found, domain.ihtn_names(), &floor);
    let ihtn = IhtnForm { people: options.people.clone(), objects, places, ..IhtnForm::default() };
    let comment = comment(&file, &args.map, &ihtn);
    let known: Vec<&DomainFile> = extensions.files().collect();
    let name = DomainId::new(options.name.as_str()).unwrap_or_else(|_| DomainId::new("ihtn").expect("a slug"));
    let yaml = scaffold_yaml(&scaffold(name, ihtn, &found.actions, domain.ihtn_names(), &known), &comment);

    // A domain that does not suffice is not written.
    let declared = domains::parse(Path::new("the scaffolded domain"), &yaml, extensions)?;
    let complete = domain
        .with_types(declared.task_types())
        .with_ihtn_names(declared.ihtn_names())
        .with_places(floor.topology.places.keys().cloned());
    let mission = import_ihtn(&text, &options, &complete).map_err(in_file)?;
    divide_and_check(&mission).map_err(|error| Diagnostics::from(Diagnostic::for_file(&file, error)))?;
    for location in declared.ihtn_names().places.keys() {
        output::note(format_args!(
            "{file}: the map {} has no place {location:?}; see `places` in the domain",
            args.map
        ));
    }
    Ok(yaml)
}

/// Returns places of the map for the locations that it lacks: rooms that the mission does not use,
/// as long as there are any.
fn stand_ins(found: &UndeclaredActions, names: &IhtnNames, floor: &LoadedMap) -> BTreeMap<String, PlaceId> {
    let places = &floor.topology.places;
    let on_map = |location: &str| places.keys().any(|place| place.as_str() == location);
    let is_used = |place: &PlaceId| found.locations.iter().any(|location| location == place.as_str());
    let rooms: Vec<PlaceId> = match &floor.map {
        Some(map) => {
            map.places().iter().filter(|place| place.kind == PlaceKind::Room).map(|place| place.id.clone()).collect()
        }
        None => vec![],
    };
    let all: Vec<PlaceId> = if rooms.is_empty() { places.keys().cloned().collect() } else { rooms };
    let (used, free): (Vec<PlaceId>, Vec<PlaceId>) = all.into_iter().partition(is_used);
    let candidates = if free.is_empty() { used } else { free };
    let missing = found.locations.iter().filter(|location| !on_map(location) && !names.places.contains_key(*location));
    missing.cloned().zip(candidates.into_iter().cycle()).collect()
}

fn comment(file: &str, map: &str, ihtn: &IhtnForm) -> Vec<String> {
    let mut lines = vec![
        format!("Domain of the actions of {file:?}, written by `consort domain scaffold`."),
        "Actions of the standard domain are not listed. `simulate` is a guess for the simulator.".to_owned(),
    ];
    if ihtn.people.is_empty() {
        lines.push("All agents are robots, except for `--person NAME` and `ihtn: { people: [NAME] }`.".to_owned());
    }
    if !ihtn.places.is_empty() {
        lines.push(format!("`places` are rooms in place of locations that the map {map:?} lacks: correct them."));
    }
    lines
}
