//! The shipped JSON Schemas match the code. Files that the program accepts satisfy them, and files
//! that the program rejects for their form violate them. Python's `jsonschema` checks the latter
//! two; without it these checks are skipped.

use super::page::repository;
use super::skip::skip;
use consort_lab::command::schema::design_schema;
use consort_nodes::check::{self, FileKind};
use consort_nodes::command::schema::schema;
use consort_protocol::event::Event;
use consort_protocol::view::{PUBLISHED_VIEWS, WithProvenance, schema_of};
use consort_skills::extensions::Extensions;
use consort_world::world::WorldReport;
use schemars::Schema;
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const KINDS: [(&str, FileKind); 10] = [
    ("mission", FileKind::Mission),
    ("map", FileKind::Map),
    ("fleet", FileKind::Fleet),
    ("robot", FileKind::Robot),
    ("station", FileKind::Station),
    ("world", FileKind::World),
    ("workers", FileKind::Workers),
    ("design", FileKind::Design),
    ("calibration", FileKind::Calibration),
    ("domain", FileKind::Domain),
];

/// Returns the schemas of all views, by name.
pub(crate) fn published_views() -> Vec<(String, Schema)> {
    let views = PUBLISHED_VIEWS.iter().map(|view| (view.name.to_owned(), (view.schema)()));
    let world = ("world".to_owned(), schema_of::<WithProvenance<WorldReport>>());
    views.chain([world]).collect()
}

#[test]
fn the_schemas_of_views_and_events_match_the_code() {
    let views = published_views().into_iter().map(|(name, schema)| (format!("view-{name}"), schema.to_value()));
    let events = [("event".to_owned(), schema_of::<Event>().to_value())];
    check_folder("docs/schemas/published", views.chain(events).collect());
}

#[test]
fn the_schemas_of_driver_messages_match_the_code() {
    check_folder("docs/schemas/driver", consort_driver::message_schemas());
}

/// Checks that a folder contains these schemas, and no others.
fn check_folder(folder: &str, schemas: Vec<(String, Value)>) {
    let folder = repository().join(folder);
    let mut names = vec![];
    for (name, schema) in schemas {
        let name = format!("{name}.json");
        let text = serde_json::to_string_pretty(&schema).expect("JSON") + "\n";
        check_shipped(&folder.join(&name), &text);
        names.push(name);
    }
    let shipped = std::fs::read_dir(folder).expect("a folder of the repository").flatten();
    let mut shipped: Vec<String> = shipped.map(|file| file.file_name().to_string_lossy().into_owned()).collect();
    shipped.sort();
    names.sort();
    assert_eq!(shipped, names);
}

/// Checks that a shipped schema has this text.
fn check_shipped(path: &Path, text: &str) {
    if std::env::var_os("CONSORT_DOCUMENTATION").is_some() {
        std::fs::write(path, text).expect("a shipped schema");
    }
    let shipped = std::fs::read_to_string(path).expect("a shipped schema");
    assert!(shipped == text, "{}: CONSORT_DOCUMENTATION=1 writes it anew", path.display());
}

/// Returns the schema of a kind of file, from the program that reads it.
pub(crate) fn file_schema(kind: FileKind) -> Value {
    let schema = if kind == FileKind::Design { Some(design_schema()) } else { schema(kind) };
    schema.expect("a kind with a schema").to_value()
}

#[test]
fn the_shipped_schemas_match_the_code() {
    let folder = repository().join("docs/schemas");
    for (name, kind) in KINDS {
        let path = folder.join(format!("{name}.json"));
        check_shipped(&path, &(serde_json::to_string_pretty(&file_schema(kind)).expect("JSON") + "\n"));
    }
    let files = std::fs::read_dir(folder).expect("a folder of the repository").flatten();
    assert_eq!(files.filter(|file| file.path().is_file()).count(), KINDS.len());
}

/// Returns the files in a folder with these suffixes.
fn files(folder: &str, endings: &[&str]) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(repository().join(folder)).expect("a folder of the repository").flatten();
    let paths = entries.map(|entry| entry.path());
    let mut found: Vec<PathBuf> =
        paths.filter(|path| endings.iter().any(|ending| path.to_string_lossy().ends_with(ending))).collect();
    found.sort();
    found
}

/// Parses a file as a JSON value.
fn value(text: &str, path: &Path) -> Value {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("toml") => serde_json::to_value(text.parse::<toml::Table>().expect("TOML")).expect("TOML is JSON"),
        Some("json") => serde_json::from_str(text).expect("JSON"),
        _ => serde_saphyr::from_str(text).expect("YAML"),
    }
}

/// Validates values against their schemas. Returns an error text or `None` for each; returns `None`
/// without Python's `jsonschema`.
fn validate(values: &[(FileKind, Value)]) -> Option<Vec<Option<String>>> {
    const JUDGE: &str = "import json, sys\nfrom jsonschema import Draft202012Validator as V\nout = []\n\
        for a in json.load(sys.stdin):\n    V.check_schema(a['schema'])\n    e = next(V(a['schema']).iter_errors(a['value']), None)\n    \
        out.append(e and f'{e.json_path}: {e.message}')\nprint(json.dumps(out))";
    let values: Vec<Value> =
        values.iter().map(|(kind, value)| json!({ "schema": file_schema(*kind), "value": value })).collect();
    let python = Command::new("python3").args(["-c", JUDGE]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
    let mut python = python.ok()?;
    let question = serde_json::to_vec(&values).expect("JSON");
    // Without `jsonschema` the script ends before it has read its input.
    let _ = python.stdin.take().expect("it was piped").write_all(&question);
    let output = python.wait_with_output().expect("it was started");
    output.status.success().then(|| serde_json::from_slice(&output.stdout).expect("JSON"))
}

const NO_JSONSCHEMA: &str = "python3 has no jsonschema (apt-get install python3-jsonschema)";

#[test]
fn shipped_files_satisfy_their_schemas() {
    let mut paths = files("examples", &[".toml", ".yaml"]);
    paths.extend(files("examples/vacuum", &[".toml", ".yaml"]));
    paths.extend(files("examples/battery-swap", &[".yaml"]));
    paths.extend(files("skills/missions", &[".yaml"]));
    paths.extend(files("tests/features/missions", &[".yaml"]));
    paths.extend(files("tests/features/maps", &[".yaml"]));
    paths.extend(files("sim_bridge/evaluation/designs", &[".toml"]));
    paths.extend(["hospital", "clinic"].map(|name| repository().join(format!("sim_bridge/world/maps/{name}.yaml"))));
    let values: Vec<(FileKind, Value)> = paths
        .iter()
        .map(|path| {
            let text = std::fs::read_to_string(path).expect("a file of the repository");
            (check::detect_kind(path).expect("a shipped file"), value(&text, path))
        })
        .collect();
    assert!(values.len() > 20, "{} files", values.len());
    let Some(errors) = validate(&values) else { return skip(NO_JSONSCHEMA) };
    let wrong: Vec<String> =
        paths.iter().zip(errors).filter_map(|(path, error)| Some(format!("{}: {}", path.display(), error?))).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn schemas_and_program_accept_the_same_forms() {
    let world = |body: &str| {
        format!(
            "[[robot]]\nid = \"a\"\nplace = \"Dock\"\nspeed_mps = 1.0\nbattery = 1.0\ndischarge_share_per_s = 0.0\n{body}"
        )
    };
    let mission = |root: &str| format!("mission: m\nroles: {{ r: {{ kind: managed }} }}\nroot: {root}\n");
    let go = "{ task: go, type: wait, roles: [r], parameters: { seconds: \"1\" } }";
    let domain = |reading: &str| format!("domain: d\nreadings:\n  {reading}\n");
    let cases: Vec<(FileKind, &str, String, bool)> = vec![
        (FileKind::Mission, "m.yaml", mission(go), true),
        (FileKind::Mission, "m.yaml", mission(&format!("{{ task: all, method: unordered, tasks: [{go}] }}")), true),
        (FileKind::Mission, "m.yaml", mission(&go.replace("parameters", "parametres")), false),
        (FileKind::Mission, "m.yaml", mission(&format!("{{ task: all, method: backwards, tasks: [{go}] }}")), false),
        (
            FileKind::Mission,
            "m.yaml",
            mission(&format!("{{ task: all, method: unordered, type: wait, tasks: [{go}] }}")),
            false,
        ),
        (FileKind::Mission, "m.yaml", mission("{ task: nothing }"), false),
        (FileKind::Mission, "m.yaml", mission(&go.replace("roles", "attempts: 11, roles")), false),
        (FileKind::Mission, "m.yaml", mission(&go.replace("task: go", "task: \"a/b\"")), false),
        (FileKind::Mission, "m.yaml", mission(go).replace("managed", "mangaged"), false),
        (FileKind::Map, "m.yaml", "name: m\nplaces:\n  - { name: A, kind: room, x_m: 0, y_m: 0 }\n".to_owned(), true),
        (FileKind::Map, "m.yaml", "name: m\nplaces:\n  - { name: A, kind: rome, x_m: 0, y_m: 0 }\n".to_owned(), false),
        (FileKind::Map, "m.yaml", "name: m\nplaces:\n  - { name: A, kind: room, y_m: 0 }\n".to_owned(), false),
        (FileKind::Fleet, "f.toml", "name = \"ward\"\ntiming = \"wifi\"\n".to_owned(), true),
        (FileKind::Fleet, "f.toml", "name = \"ward\"\ntiming = \"slow\"\n".to_owned(), false),
        (FileKind::Fleet, "f.toml", "[limits]\ncharge_min = 3\n".to_owned(), false),
        (FileKind::Station, "s.toml", "name = \"s\"\n[fleet]\nmap = \"hospital\"\n".to_owned(), true),
        (FileKind::Station, "s.toml", "name = \"s\"\nstationery = true\n".to_owned(), false),
        (FileKind::Robot, "r.toml", "name = \"r\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\n".to_owned(), true),
        (FileKind::Robot, "r.toml", "name = \"r\"\nskills = [\"pick_up\"]\n".to_owned(), false),
        (FileKind::World, "w.toml", world("kinematics = { kind = \"differential\", acceleration_mps2 = 0.5 }\n"), true),
        (
            FileKind::World,
            "w.toml",
            world("kinematics = { kind = \"aerial\" }\nsensors = [{ kind = \"range\", reach_m = 5.0 }]\n"),
            true,
        ),
        (FileKind::World, "w.toml", world("kinematics = { kind = \"legged\" }\n"), false),
        (FileKind::World, "w.toml", world("sensors = [{ kind = \"camera\", reach_m = 5.0 }]\n"), false),
        (FileKind::World, "w.toml", world("wheels = 3\n"), false),
        (FileKind::Workers, "w.json", "[{ \"name\": \"a\", \"place\": \"Dock\", \"skills\": [] }]".to_owned(), true),
        (
            FileKind::Workers,
            "w.json",
            "{ \"worker\": [{ \"name\": \"a\", \"place\": \"Dock\", \"skills\": [] }] }".to_owned(),
            true,
        ),
        (FileKind::Workers, "w.json", "[{ \"name\": \"a\", \"place\": \"Dock\" }]".to_owned(), false),
        (FileKind::Domain, "d.yaml", domain("lid: { type: bool, simulate: { value: true } }"), true),
        (FileKind::Domain, "d.yaml", domain("bag_g: { type: number, unit: g, minimum: 0, maximum: 5 }"), true),
        (FileKind::Domain, "d.yaml", domain("bag_g: { type: number, minmum: 0 }"), false),
        (FileKind::Domain, "d.yaml", domain("bag_g: { minimum: 0 }"), false),
        (FileKind::Domain, "d.yaml", domain("lid: { type: bool, simulate: { start: true } }"), false),
    ];
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("documentation/forms");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let mut values = vec![];
    for (kind, file, text, taken) in &cases {
        let path = folder.join(file);
        std::fs::write(&path, text).expect("cargo's own folder");
        let program = check::check_file(&path, Some(*kind), &[], Extensions::default());
        assert_eq!(program.is_ok(), *taken, "{text}\n{program:?}");
        values.push((*kind, value(text, &path)));
    }
    let Some(errors) = validate(&values) else { return skip(NO_JSONSCHEMA) };
    for ((kind, _, text, taken), error) in cases.iter().zip(errors) {
        assert_eq!(error.is_none(), *taken, "{kind}: {text}\n{error:?}");
    }
}
