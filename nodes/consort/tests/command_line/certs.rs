//! Certificate commands and manual pages.

use crate::support::{run, test_file};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Returns the folder of a test, which does not exist yet.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(&test_file(&format!("{name}.mark"), "")).with_extension("certs");
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

fn cert(dir: &Path, arguments: &[&str]) -> (i32, String) {
    let dir = dir.display().to_string();
    let ran = run(&[&["cert", "--dir", &dir][..], arguments].concat());
    (ran.code.expect("it ends by itself"), format!("{}{}", ran.out, ran.err))
}

#[test]
fn certificates_are_created_shown_renewed_and_revoked() {
    let dir = folder("made");
    let (code, output) = cert(&dir, &["node", "ada", "--roles", "robot"]);
    assert!(code == 2 && output.contains("there is no authority here; `consort cert init"), "{output}");
    assert_eq!(cert(&dir, &["init", "--fleet", "ward"]).0, 0);
    let (code, output) = cert(&dir, &["init", "--fleet", "ward"]);
    assert!(code == 2 && output.contains("there is an authority already"), "{output}");
    assert_eq!(cert(&dir, &["node", "ada", "--roles", "robot,voter", "--address", "192.0.2.7"]).0, 0);
    assert_eq!(cert(&dir, &["person", "kim", "--scope", "submit", "--days", "30"]).0, 0);
    let (code, output) = cert(&dir, &["node", "ada", "--roles", "robot"]);
    assert!(code == 2 && output.contains("it exists already; `consort cert renew`"), "{output}");
    let (code, output) = cert(&dir, &["node", "bob", "--roles", "boss"]);
    assert!(code == 2 && output.contains("allowed: robot, voter, host"), "{output}");
    let (code, output) = cert(&dir, &["node", "world", "--roles", "host"]);
    assert!(code == 2 && output.contains("the role host needs --serves"), "{output}");
    let (code, output) = cert(&dir, &["node", "bob", "--roles", "robot", "--serves", "ada"]);
    assert!(code == 2 && output.contains("--serves is for nodes with the role host"), "{output}");
    let (code, output) = cert(&dir, &["node", "world", "--roles", "host", "--serves", "a da"]);
    assert!(code == 2 && output.contains("contains ' '"), "{output}");
    let (code, output) = cert(&dir, &["person", "authority"]);
    assert!(code == 2 && output.contains("this name is reserved for the authority"), "{output}");

    for key in ["authority/ca.key", "ada/key.pem", "kim/key.pem"] {
        let mode = std::fs::metadata(dir.join(key)).expect(key).permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{key}");
    }
    let shown = || -> serde_json::Value { serde_json::from_str(&cert(&dir, &["show", "--json"]).1).expect("JSON") };
    let before = shown();
    assert_eq!(before[0]["identity"], "consort://ward/node/ada?roles=robot,voter");
    assert_eq!(before[0]["addresses"], serde_json::json!(["192.0.2.7"]));
    assert_eq!((&before[1]["name"], &before[1]["state"]), (&"kim".into(), &"valid".into()));
    assert_eq!(before[1]["days_left"], 29);

    let key = std::fs::read_to_string(dir.join("ada/key.pem")).expect("a key");
    assert_eq!(cert(&dir, &["renew", "ada"]).0, 0);
    let after = shown();
    assert_ne!(std::fs::read_to_string(dir.join("ada/key.pem")).expect("a key"), key);
    assert_ne!(after[0]["serial"], before[0]["serial"]);
    assert_eq!((&after[0]["identity"], &after[0]["addresses"]), (&before[0]["identity"], &before[0]["addresses"]));

    let (code, output) = cert(&dir, &["revoke", "bob"]);
    assert!(code == 2 && output.contains("there is no certificate of \"bob\"; there are: ada, kim"), "{output}");
    let (code, output) = cert(&dir, &["revoke", "ada"]);
    assert!(code == 0 && output.contains("kim/revoked.pem"), "{output}");
    assert_eq!((&shown()[0]["state"], &shown()[1]["state"]), (&"revoked".into(), &"valid".into()));
    // A certificate that was revoked before stays revoked.
    assert_eq!(cert(&dir, &["revoke", "kim"]).0, 0);
    assert_eq!((&shown()[0]["state"], &shown()[1]["state"]), (&"revoked".into(), &"revoked".into()));
}

#[test]
fn completions_and_manual_pages_cover_every_command() {
    let bash = run(&["completions", "bash"]);
    assert_eq!(bash.code, Some(0), "{}", bash.err);
    let dir = folder("man");
    assert_eq!(run(&["man", &dir.display().to_string()]).code, Some(0));
    for command in ["submit", "robot", "cert", "doctor"] {
        assert!(bash.out.contains(&format!("consort,{command}")), "{command}");
        let page = std::fs::read_to_string(dir.join(format!("consort-{command}.1"))).expect(command);
        assert!(page.contains(".TH") && page.contains("Examples"), "{command}");
    }
}
