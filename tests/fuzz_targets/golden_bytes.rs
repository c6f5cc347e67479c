//! Golden bytes: this version writes the same bytes as long as the fleet uses the first wire version, and
//! reads them.
//!
//! `golden_bytes/2/` contains messages and records, the seeds of some targets. Only a new version adds a
//! folder. Records of releases up to 0.2.0 have version 1 and are refused.

use super::{seeds, target};
use consort_protocol::codec::{self, CodecError};
use consort_protocol::ledger::Ledger;
use std::fs;
use std::path::Path;

#[test]
fn the_golden_bytes_are_unchanged() {
    for name in ["wire", "raft", "award", "checkpoint", "ledger"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz_targets/golden_bytes/2").join(name);
        let written = seeds::at_version(1, name);
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), written.len(), "{name}");
        for (nth, now) in written.iter().enumerate() {
            let then = fs::read(folder.join(format!("seed-{nth}"))).expect("a kept file");
            assert_eq!(&then, now, "{name}, seed {nth}: a layout has changed, and its version has not");
            assert!((target(name).run)(&then), "{name}, seed {nth}");
        }
    }
}

/// A store of a release up to 0.2.0 is no damaged store: its version is named.
#[test]
fn records_of_earlier_releases_are_refused_by_their_version() {
    let mut record = codec::encode_record(&Ledger::default()).expect("an empty ledger");
    record[0] = 1;
    let refused = codec::decode_record::<Ledger>(&record);
    assert!(matches!(refused, Err(CodecError::Version { found: 1, known: codec::RECORD_VERSION })));
}
