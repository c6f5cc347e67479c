//! Dependencies match `deny.toml`, the modules of each crate have no cycles and a single layout, and no
//! crate contains words of a layer above it. cargo-deny checks more but must be installed; this test needs cargo alone.

mod module_cycles;
mod module_layout;

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use toml::Table;

/// Lock files of this repository: the main workspace and two separate workspaces.
const LOCKS: [&str; 3] = ["Cargo.lock", "sim_bridge/ros2/Cargo.lock", "tests/fuzz/Cargo.lock"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(file: &str) -> String {
    fs::read_to_string(root().join(file)).unwrap_or_else(|problem| panic!("{file}: {problem}"))
}

fn table(file: &str) -> Table {
    read(file).parse().unwrap_or_else(|problem| panic!("{file}: {problem}"))
}

/// Returns the tables of a list in a section.
fn entries(deny: &Table, section: &str, list: &str) -> Vec<Table> {
    let list = deny[section][list].as_array().expect("a list");
    list.iter().map(|entry| entry.as_table().expect("each is a table").clone()).collect()
}

fn text<'a>(entry: &'a Table, key: &str) -> &'a str {
    entry.get(key).and_then(toml::Value::as_str).unwrap_or_else(|| panic!("{entry}: {key} is missing"))
}

fn texts(list: &toml::Value) -> BTreeSet<String> {
    list.as_array().expect("a list").iter().map(|text| text.as_str().expect("a text").to_owned()).collect()
}

/// Returns the names and versions in a lock file.
fn locked(lock: &str) -> BTreeSet<(String, String)> {
    let table = table(lock);
    let packages = table["package"].as_array().expect("a list");
    let of = |package: &toml::Value, key: &str| package[key].as_str().expect("a text").to_owned();
    packages.iter().map(|package| (of(package, "name"), of(package, "version"))).collect()
}

/// Checks whether allowed licences satisfy an SPDX expression:
/// `(MIT OR Apache-2.0) AND Unicode-3.0`.
fn is_met(expression: &str, is_allowed: &dyn Fn(&str) -> bool) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut words = spaced.split_whitespace().peekable();
    let met = any(&mut words, is_allowed);
    assert_eq!(words.next(), None, "{expression:?} is no expression");
    met
}

type Words<'a> = std::iter::Peekable<std::str::SplitWhitespace<'a>>;

fn any(words: &mut Words<'_>, is_allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut met = all(words, is_allowed);
    while words.next_if_eq(&"OR").is_some() {
        met |= all(words, is_allowed);
    }
    met
}

fn all(words: &mut Words<'_>, is_allowed: &dyn Fn(&str) -> bool) -> bool {
    let mut met = one(words, is_allowed);
    while words.next_if_eq(&"AND").is_some() {
        met &= one(words, is_allowed);
    }
    met
}

fn one(words: &mut Words<'_>, is_allowed: &dyn Fn(&str) -> bool) -> bool {
    match words.next().expect("a licence") {
        "(" => {
            let met = any(words, is_allowed);
            assert_eq!(words.next(), Some(")"), "what is opened is closed");
            met
        }
        licence => match words.next_if_eq(&"WITH") {
            Some(_) => is_allowed(&format!("{licence} WITH {}", words.next().expect("an exception"))),
            None => is_allowed(licence),
        },
    }
}

#[test]
fn licence_expressions_are_evaluated() {
    let allowed = |licence: &str| ["MIT", "Zlib", "A WITH B"].contains(&licence);
    for met in ["MIT", "GPL-3.0 OR MIT", "GPL/MIT", "(GPL OR MIT) AND Zlib", "A WITH B OR GPL"] {
        assert!(is_met(met, &allowed), "{met}");
    }
    for unmet in ["GPL", "MIT AND GPL", "(GPL OR B) AND MIT", "A", "A WITH C"] {
        assert!(!is_met(unmet, &allowed), "{unmet}");
    }
}

#[test]
fn every_licence_is_allowed() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let arguments = ["metadata", "--format-version", "1", "--locked", "--filter-platform", "x86_64-unknown-linux-gnu"];
    let output = Command::new(cargo).args(arguments).current_dir(root()).output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let deny = table("deny.toml");
    let allowed = texts(&deny["licenses"]["allow"]);
    let exceptions = entries(&deny, "licenses", "exceptions");
    let exceptions: BTreeMap<&str, BTreeSet<String>> =
        exceptions.iter().map(|entry| (text(entry, "crate"), texts(&entry["allow"]))).collect();
    let packages = metadata["packages"].as_array().expect("a list");
    assert!(packages.len() > 200, "{} packages are not all there are", packages.len());
    let refused = packages.iter().filter_map(|package| {
        let (name, licence) = (package["name"].as_str()?, package["license"].as_str().unwrap_or("none"));
        let own = exceptions.get(name);
        let is_allowed = |licence: &str| allowed.contains(licence) || own.is_some_and(|own| own.contains(licence));
        (!is_met(licence, &is_allowed)).then(|| format!("{name}: {licence}"))
    });
    let refused: Vec<String> = refused.collect();
    assert!(refused.is_empty(), "deny.toml does not allow {}", refused.join(", "));
}

#[test]
fn every_dependency_comes_from_the_registry() {
    for lock in LOCKS {
        let table = table(lock);
        let packages = table["package"].as_array().expect("a list");
        for package in packages {
            let (name, source) = (&package["name"], package.get("source").and_then(toml::Value::as_str));
            let from = source.unwrap_or("registry+https://github.com/rust-lang/crates.io-index");
            assert_eq!(from, "registry+https://github.com/rust-lang/crates.io-index", "{lock}: {name}");
        }
    }
}

#[test]
fn every_exception_is_explained_and_still_needed() {
    let (deny, lines) = (table("deny.toml"), read("deny.toml"));
    let anywhere: BTreeSet<(String, String)> = LOCKS.iter().flat_map(|lock| locked(lock)).collect();
    let is_there = |name: &str, version: &str| {
        let is_of = |known: &str| known == version || known.starts_with(&format!("{version}."));
        anywhere.iter().any(|(known, of)| known == name && (version.is_empty() || is_of(of)))
    };
    for exception in entries(&deny, "licenses", "exceptions") {
        let name = text(&exception, "crate");
        assert!(is_there(name, ""), "nothing is called {name} any more");
        let line = lines.lines().find(|line| line.contains(&format!("crate = \"{name}\", allow"))).expect("its line");
        assert!(line.split_once('#').is_some_and(|(_, why)| why.trim().len() > 10), "why? {line}");
    }
    for (section, list) in [("bans", "skip"), ("bans", "skip-tree"), ("bans", "deny"), ("advisories", "ignore")] {
        for entry in entries(&deny, section, list) {
            assert!(text(&entry, "reason").len() > 5, "why? {entry}");
        }
    }
    for list in ["skip", "skip-tree"] {
        for skipped in entries(&deny, "bans", list) {
            let (name, version) = text(&skipped, "crate").split_once('@').unwrap_or((text(&skipped, "crate"), ""));
            assert!(is_there(name, version), "{name} {version} is not there any more");
        }
    }
    let ours = locked("Cargo.lock");
    for banned in entries(&deny, "bans", "deny") {
        let name = text(&banned, "crate");
        assert!(ours.iter().all(|(known, _)| known != name), "{name} is there: {}", text(&banned, "reason"));
    }
}

#[test]
fn modules_of_a_crate_have_no_cycles() {
    let workspace = table("Cargo.toml");
    let members = workspace["workspace"]["members"].as_array().expect("a list");
    let mut found = Vec::new();
    for package in members.iter().map(|member| member.as_str().expect("a folder")) {
        for cycle in module_cycles::cycles(&root().join(package)) {
            let (children, uses) = (Vec::from_iter(cycle.children), Vec::from_iter(cycle.uses));
            found.push(format!("{package} {}: {}\n    {}", cycle.parent, children.join(", "), uses.join("\n    ")));
        }
    }
    assert!(found.is_empty(), "modules depend on each other:\n{}", found.join("\n"));
}

#[test]
fn modules_have_a_single_layout() {
    let workspace = table("Cargo.toml");
    let members = workspace["workspace"]["members"].as_array().expect("a list");
    let folders = members.iter().map(|member| member.as_str().expect("a folder")).chain(["sim_bridge/ros2"]);
    let found: Vec<String> =
        folders.flat_map(|package| module_layout::violations(&root().join(package).join("src"))).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Words of the lab samples, which are a mission of the hospital domain.
const DOMAIN_WORDS: [&str; 3] = ["drawer", "nurse", "sample"];

/// These words where `sample` alone is a message of the bus, or a function of a library.
const PROTOCOL_WORDS: [&str; 5] = ["drawer", "nurse", "lab-sample", "lab_sample", "lab sample"];

/// Returns `place: word` for each of the words in a text, whatever their case.
fn used_words(place: &Path, text: &str, words: &[&str]) -> Vec<String> {
    let text = text.to_lowercase();
    let used = words.iter().filter(|word| text.contains(**word));
    used.map(|word| format!("{}: {word}", place.display())).collect()
}

#[test]
fn protocol_and_actors_contain_no_words_of_a_domain() {
    let files: Vec<PathBuf> =
        ["protocol", "actors"].iter().flat_map(|folder| module_layout::files(&root().join(folder))).collect();
    assert!(files.len() > 200, "{} files are not all there are", files.len());
    let mut found = Vec::new();
    for file in files {
        let bytes = fs::read(&file).unwrap_or_else(|problem| panic!("{}: {problem}", file.display()));
        found.extend(used_words(&file, &String::from_utf8_lossy(&bytes), &PROTOCOL_WORDS));
    }
    assert!(found.is_empty(), "use a word of any domain, such as clerk or box:\n{}", found.join("\n"));
}

/// Returns the enums in a formatted Rust source text.
fn enums(text: &str) -> Vec<String> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let mut words = code.split_whitespace().skip_while(|word| word.starts_with("pub"));
        if words.next() == Some("enum") {
            let last = format!("{}}}", &line[..line.len() - code.len()]);
            let length = lines[start..].iter().position(|line| *line == last || code.ends_with('}'));
            found.push(lines[start..=start + length.expect("the enum ends")].join("\n"));
        }
    }
    found
}

#[test]
fn enums_of_skills_contain_no_words_of_a_domain() {
    let text =
        "pub enum A {\n    B { c: u8 },\n}\n// enum C {\nmod d {\n    enum E {\n        F,\n    }\n}\nenum G {}\n";
    assert_eq!(enums(text), ["pub enum A {\n    B { c: u8 },\n}", "    enum E {\n        F,\n    }", "enum G {}"]);
    let mut files = module_layout::files(&root().join("skills"));
    files.retain(|file| file.extension().is_some_and(|extension| extension == "rs"));
    let (mut count, mut found) = (0, Vec::new());
    for file in files {
        let text = fs::read_to_string(&file).unwrap_or_else(|problem| panic!("{}: {problem}", file.display()));
        for text in enums(&text) {
            count += 1;
            found.extend(used_words(&file, &text, &DOMAIN_WORDS));
        }
    }
    assert!(count > 20, "{count} enums are not all there are");
    assert!(found.is_empty(), "use a word of any domain, such as container:\n{}", found.join("\n"));
}
