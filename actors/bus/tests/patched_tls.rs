//! The patched TLS link of Zenoh differs from the published crate by its patch alone.

use std::io::Write;
use std::path::Path;
use std::process::Command;

#[test]
fn the_patched_tls_link_is_the_published_crate_plus_its_patch() {
    if Command::new("patch").arg("--version").output().is_err() {
        let _ = writeln!(std::io::stderr(), "skipped: the command `patch` is not installed");
        return;
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../patched/zenoh-link-tls");
    let check = Command::new(folder.join("check.sh")).output().expect("a shell");
    let (out, err) = (String::from_utf8_lossy(&check.stdout), String::from_utf8_lossy(&check.stderr));
    assert!(check.status.success(), "{out}{err}");
    let patch = std::fs::read_to_string(folder.join("difference.patch")).expect("the patch");
    let changed = |line: &&str| line.starts_with(['+', '-']) && !line.starts_with("+++") && !line.starts_with("---");
    let changed = patch.lines().filter(changed).count();
    assert!(changed <= 24, "{changed} changed lines: keep the difference small");
}
