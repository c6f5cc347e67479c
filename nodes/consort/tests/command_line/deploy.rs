//! Shipped deployment files: configurations and units.

use super::skip::skip;
use super::support::{crate_file, run};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the files in a folder of this crate, in order.
fn files(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(crate_file(folder)).expect("a folder that is shipped");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    files
}

#[test]
fn the_configurations_of_every_topology_are_valid() {
    for topology in ["lan", "site", "sites", "campus"] {
        let files = files(&format!("../deploy/topologies/{topology}"));
        let paths: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
        let mut args = vec!["check"];
        args.extend(paths.iter().map(String::as_str));
        let ran = run(&args);
        assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
        for path in &files {
            // The unit of a node finds the file by the name of the node.
            let name = path.file_stem().and_then(|stem| stem.to_str()).expect("a name");
            let table: toml::Table = fs::read_to_string(path).expect("a file").parse().expect("TOML");
            let expected = if name == "fleet" { "ward" } else { name };
            assert_eq!(table["name"].as_str(), Some(expected), "{}", path.display());
            assert!(name == "fleet" || table["fleet"].as_str() == Some("fleet.toml"), "{}", path.display());
        }
    }
}

/// Copies a folder recursively.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("cargo's own folder");
    for entry in fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy(&entry.path(), &target),
            false => drop(fs::copy(entry.path(), target).expect("cargo's own folder")),
        }
    }
}

#[test]
fn systemd_accepts_the_units() {
    let system = Path::new("/lib/systemd/system");
    if Command::new("systemd-analyze").arg("--version").output().is_err() || !system.exists() {
        return skip("no program systemd-analyze, or no units of systemd");
    }
    let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("command_line/machine");
    let units = root.join("usr/lib/systemd/system");
    copy(&PathBuf::from(crate_file("../deploy/systemd")), &units);
    let targets = ["basic", "multi-user", "network", "network-online", "rescue", "shutdown", "sysinit", "time-sync"];
    for target in targets.map(|target| format!("{target}.target")) {
        fs::copy(system.join(&target), units.join(&target)).expect("a target of systemd's own");
    }
    let program = root.join("usr/bin/consort");
    fs::create_dir_all(root.join("usr/bin")).expect("cargo's own folder");
    // A previous run may have left a link.
    let _ = fs::remove_file(&program);
    fs::hard_link(env!("CARGO_BIN_EXE_consort"), &program).expect("the same file system");
    let root = format!("--root={}", root.display());
    for kind in ["station", "robot", "world"] {
        let unit = format!("consort-{kind}@{kind}-1.service");
        let verified = Command::new("systemd-analyze").args(["verify", "--man=no", &root, &unit]).output();
        let verified = verified.expect("it was there a moment ago");
        // An unknown key does not make it fail.
        let text = String::from_utf8_lossy(&verified.stderr).into_owned();
        assert!(verified.status.success() && text.is_empty(), "{unit}: {text}");
    }
}
