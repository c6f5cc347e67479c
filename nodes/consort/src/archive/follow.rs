//! Follows the ledger and the events of a fleet, and archives them.

use super::files::ArchiveFiles;
use super::position::ArchivePosition;
use super::record::{ArchiveContent, ArchiveRecord, content_of};
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_bus::trust::write_atomically;
use consort_protocol::event::Event;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::Keys;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Ledger;
use consort_raft::Replica;
use std::collections::BTreeMap;
use std::io;
use std::time::Duration;
use tokio::time::interval;
use tracing::warn;

/// Interval in which the ledger is compared and the files are written. Raised: a killed station loses more events.
const INTERVAL: Duration = Duration::from_secs(1);

/// File with the position, in the folder of the archive.
const POSITION_FILE: &str = "position.json";

/// Archives until the events end, or until a file cannot be written.
pub(crate) async fn follow(
    files: ArchiveFiles,
    bus: SharedBus,
    keys: Keys,
    replica: Option<Replica<Ledger>>,
    clock: Clock,
) {
    let mut events = match bus.subscribe(&keys.any_events()).await {
        Ok(events) => events,
        Err(problem) => return warn!(%problem, "the archive cannot subscribe to events: it is not kept"),
    };
    let mut archiver = Archiver::new(files, replica, clock);
    let mut ticks = interval(INTERVAL);
    loop {
        let archived = tokio::select! {
            event = events.recv() => match event {
                Some(sample) => archiver.add_event(&sample.payload),
                None => return,
            },
            _ = ticks.tick() => archiver.write(),
        };
        if let Err(problem) = archived {
            return warn!(%problem, "the archive cannot be written: it is not kept until the node restarts");
        }
    }
}

/// The archive of a running station.
struct Archiver {
    files: ArchiveFiles,
    replica: Option<Replica<Ledger>>,
    clock: Clock,
    position: ArchivePosition,
    /// Position of the ledger when it was last compared.
    compared: Option<Epoch>,
    /// Reasons for which the latest auctions of missions had no result.
    failures: BTreeMap<MissionId, String>,
}

impl Archiver {
    fn new(files: ArchiveFiles, replica: Option<Replica<Ledger>>, clock: Clock) -> Archiver {
        // Without a position, all that the ledger remembers is archived, perhaps again.
        let text = std::fs::read(files.path_of(POSITION_FILE)).ok();
        let position = text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        Archiver { files, replica, clock, position, compared: None, failures: BTreeMap::new() }
    }

    fn add_event(&mut self, payload: &[u8]) -> io::Result<()> {
        let Ok(event) = serde_json::from_slice::<Event>(payload) else { return Ok(()) };
        let at_ms = event.at_ms;
        match content_of(event, &mut self.failures) {
            Some(content) => self.files.append(&ArchiveRecord { at_ms, content }, self.clock.wall_ms()),
            None => Ok(()),
        }
    }

    /// Adds what has changed in the ledger, and writes the files. The position is stored after the records: a crash in
    /// between repeats some.
    fn write(&mut self) -> io::Result<()> {
        let now_ms = self.clock.wall_ms();
        let before = self.position.clone();
        if let Some(replica) = &self.replica {
            let applied = *replica.applied().borrow();
            if self.compared != Some(applied) {
                self.compared = Some(applied);
                let position = &mut self.position;
                for record in replica.read_with_position(|applied, ledger| position.advance(ledger, applied, now_ms)) {
                    if let ArchiveContent::Mission(ended) = &record.content {
                        self.failures.remove(&ended.mission); // the event of its end may be lost
                    }
                    self.files.append(&record, now_ms)?;
                }
            }
        }
        self.files.flush(now_ms)?;
        if self.position != before {
            self.files.sync()?;
            let text = serde_json::to_vec(&self.position).expect("a position has a JSON form");
            write_atomically(&self.files.path_of(POSITION_FILE), &text, 0o600)?;
        }
        Ok(())
    }
}
