//! Stores on disks.

use super::frames::frames;
use consort_protocol::ledger::Ledger;
use consort_raft::store::{DurableStore, OpenError, StoreOwner};
use consort_raft::{PersistentState, StoreIdentity, inspect_log_store};
use redb::StorageBackend;
use redb::backends::InMemoryBackend;
use std::sync::{Arc, OnceLock};

/// A file that a test can read while a store has it open.
#[derive(Debug, Clone)]
struct Disk(Arc<InMemoryBackend>);

impl Disk {
    fn holding(bytes: &[u8]) -> Disk {
        let file = InMemoryBackend::new();
        file.set_len(bytes.len() as u64).expect("memory");
        file.write(0, bytes).expect("memory");
        Disk(Arc::new(file))
    }

    fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![0; usize::try_from(self.0.len().expect("memory")).expect("a small file")];
        self.0.read(0, &mut bytes).expect("memory");
        bytes
    }
}

impl StorageBackend for Disk {
    fn len(&self) -> std::io::Result<u64> {
        self.0.len()
    }
    fn read(&self, at: u64, into: &mut [u8]) -> std::io::Result<()> {
        // A file reports an error beyond its end; the memory backend does not.
        let end = at.checked_add(into.len() as u64).filter(|end| self.0.len().is_ok_and(|length| *end <= length));
        if end.is_none() {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        self.0.read(at, into)
    }
    fn set_len(&self, length: u64) -> std::io::Result<()> {
        self.0.set_len(length)
    }
    fn sync_data(&self) -> std::io::Result<()> {
        self.0.sync_data()
    }
    fn write(&self, at: u64, bytes: &[u8]) -> std::io::Result<()> {
        self.0.write(at, bytes)
    }
}

/// Files and contents of a closed store.
struct Left {
    owner: StoreOwner,
    ledger: Vec<u8>,
    seal: Vec<u8>,
    recorded: PersistentState,
}

fn left() -> &'static Left {
    static LEFT: OnceLock<Left> = OnceLock::new();
    LEFT.get_or_init(|| {
        let owner = StoreOwner { fleet: "ward".parse().expect("a slug"), node: "ada".parse().expect("a slug") };
        let (ledger, seal) = (Disk::holding(&[]), Disk::holding(&[]));
        let recorded = {
            let identity = StoreIdentity(7);
            let store = DurableStore::open_on(ledger.clone(), seal.clone(), &owner, identity).expect("a new store");
            let entries = (0..20u64).map(|index| (index, vec![7; 300])).collect();
            let recorded = PersistentState { vote: Some(vec![1; 9]), entries, ..PersistentState::default() };
            store.replace(recorded.clone()).expect("memory");
            store.begin_incarnation(5).expect("memory");
            recorded
        };
        Left { owner, ledger: ledger.bytes(), seal: seal.bytes(), recorded }
    })
}

/// A damaged store is rejected or has its original contents.
pub(super) fn store(bytes: &[u8]) -> bool {
    let Left { owner, ledger, seal, recorded } = left();
    let (mut ledger, mut seal) = (ledger.clone(), seal.clone());
    let mut harmed = false;
    for (kind, piece) in frames(bytes) {
        let file = if kind & 1 == 0 { &mut ledger } else { &mut seal };
        let Some((place, bytes)) = piece.split_first_chunk::<4>() else { continue };
        let place = usize::try_from(u32::from_le_bytes(*place)).expect("64 bits") % file.len().max(1);
        match kind / 2 % 3 {
            0 => file.truncate(place),
            1 => file.iter_mut().skip(place).zip(bytes).for_each(|(byte, new)| *byte = *new),
            _ => file.iter_mut().skip(place).zip(bytes).for_each(|(byte, new)| *byte ^= *new),
        }
        harmed = true;
    }
    if ledger.is_empty() && seal.is_empty() {
        return false; // a new store
    }
    let opened = DurableStore::open_on(Disk::holding(&ledger), Disk::holding(&seal), owner, StoreIdentity(8));
    let whole = opened.is_ok();
    match opened {
        Ok(store) => {
            let found = store.persistent_state().expect("an open store can be read");
            assert!(found == *recorded, "a damaged store was accepted");
        }
        Err(OpenError::InUse { .. } | OpenError::NotFound { .. }) => panic!("that is not what is wrong with it"),
        Err(problem) => {
            assert!(harmed, "a sound store is refused: {problem}");
            assert!(problem.to_string().contains("ledger"), "the error does not name the file: {problem}");
        }
    }
    let records: Vec<&[u8]> = frames(bytes).map(|(_, piece)| piece).collect();
    let nth = |nth: usize| records.get(nth).map(|bytes| bytes.to_vec());
    let entries = records.iter().skip(4).map(|bytes| bytes.to_vec());
    let recorded = PersistentState {
        vote: nth(0),
        committed: nth(1),
        purged: nth(2),
        snapshot: nth(3),
        entries: (0..).zip(entries).collect(),
    };
    if let Err(problem) = inspect_log_store::<Ledger>(recorded) {
        assert!(!problem.to_string().is_empty());
    }
    whole
}
