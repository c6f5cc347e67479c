//! What the release before wrote is read by this one, and written by it to the byte as long as the fleet writes that version.
//!
//! `kept/1/` has what release 0.1.0 sends and stores: the seeds of some targets, as `CONSORT_UNTRUSTED_SEEDS=DIR` had that release
//! write them. Only a new version of the wire adds a folder.

use super::{seeds, target};
use std::fs;
use std::path::Path;

#[test]
fn what_the_first_release_wrote_is_read_and_still_written() {
    for name in ["wire", "raft", "award", "notebook", "ledger"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/untrusted/kept/1").join(name);
        let written = seeds::at_version(1, name);
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), written.len(), "{name}");
        for (nth, now) in written.iter().enumerate() {
            let then = fs::read(folder.join(format!("seed-{nth}"))).expect("a kept file");
            assert_eq!(&then, now, "{name}, seed {nth}: a layout has changed, and its version has not");
            assert!((target(name).run)(&then), "{name}, seed {nth}");
        }
    }
}
