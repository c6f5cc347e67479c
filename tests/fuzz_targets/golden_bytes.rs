//! Golden bytes of the previous release: this version reads them, and writes the same bytes as long
//! as the fleet uses that wire version.
//!
//! `golden_bytes/1/` contains the messages and records of release 0.1.0: the seeds of some targets,
//! written by that release with `CONSORT_FUZZ_SEEDS=DIR`. Only a new wire version adds a folder. The
//! command and the state of drivers (`wire/seed-17` and `seed-18`) are those of this release: earlier
//! releases use other keys for them.

use super::{seeds, target};
use std::fs;
use std::path::Path;

#[test]
fn the_golden_bytes_of_the_first_release_are_unchanged() {
    // The folder of the first release has the old name of the target.
    for (name, folder) in
        [("wire", "wire"), ("raft", "raft"), ("award", "award"), ("checkpoint", "notebook"), ("ledger", "ledger")]
    {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz_targets/golden_bytes/1").join(folder);
        let written = seeds::at_version(1, name);
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), written.len(), "{name}");
        for (nth, now) in written.iter().enumerate() {
            let then = fs::read(folder.join(format!("seed-{nth}"))).expect("a kept file");
            assert_eq!(&then, now, "{name}, seed {nth}: a layout has changed, and its version has not");
            assert!((target(name).run)(&then), "{name}, seed {nth}");
        }
    }
}
