use super::support::{run, test_file};

#[test]
fn record_does_not_overwrite_an_existing_file() {
    let file = test_file("there.mcap", "dear diary");
    let ran = run(&["record", "--out", &file, "--connect", "tcp/127.0.0.1:1", "--timeout", "0.1"]);
    let problem = format!("consort: {file}: this file exists already; --force replaces it\n");
    assert_eq!((ran.code, ran.err), (Some(2), problem));
    // With --force the connection to the fleet fails first; the existing file is not replaced.
    let ran = run(&["record", "--out", &file, "--force", "--connect", "tcp/127.0.0.1:1", "--timeout", "0.1"]);
    assert_eq!(ran.code, Some(3), "{}", ran.err);
    assert_eq!(std::fs::read_to_string(&file).expect("it is there"), "dear diary");
    let ran = run(&["record", "--out", "run.mcap", "--for", "5 weeks"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("expected a duration above 0, as 60s, 5m, 2h or 30d"), "{}", ran.err);
}

#[test]
fn replay_rejects_other_files_with_their_kind() {
    let file = test_file("notes.mcap", "these are my notes, and no recording");
    let world = test_file("world.mcap", "");
    let recorded = run(&["demo", "--virtual", "--no-kill", "--record", &world]);
    assert_eq!(recorded.code, Some(0), "{}", recorded.err);
    for (file, expected) in [
        ("/no/such/run.mcap", "this recording cannot be read: No such file"),
        (&file, "this is not an MCAP file: it has no MCAP header; `consort record --out FILE` makes recordings"),
        (
            &world,
            "this MCAP file is not a recording of a fleet: it has no data of `consort record`; it is a recording of a world",
        ),
    ] {
        let ran = run(&["replay", file]);
        assert_eq!(ran.code, Some(2), "{}", ran.err);
        assert!(ran.err.starts_with(&format!("consort: {file}: {expected}")), "{}", ran.err);
    }
}
