//! Durable store: reading returns exactly the written data, or an error.

use consort_protocol::ids::{FleetId, NodeId};
use consort_raft::store::{
    COMMIT_MARKER_FILE, CheckpointStore, DurableStore, LEDGER_FILE, OpenError, Quarantine, StoreOwner,
};
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

mod crash;
mod hooked_log_store;
mod purge_after_snapshot;
mod replica;

/// Temporary directory of a test, removed at its end.
struct TempDir(PathBuf);

impl TempDir {
    fn new() -> TempDir {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("consort-store-{}-{count}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder");
        TempDir(path)
    }
}

impl std::ops::Deref for TempDir {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for TempDir {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn owner(node: &str) -> StoreOwner {
    StoreOwner { fleet: FleetId::new("ward").expect("a slug"), node: NodeId::new(node).expect("a slug") }
}

fn open(folder: &Path) -> Result<DurableStore, OpenError> {
    // A different identity each time: it only matters at the creation.
    static COUNT: AtomicU64 = AtomicU64::new(1);
    DurableStore::open(folder, &owner("ada"), StoreIdentity(u128::from(COUNT.fetch_add(1, Ordering::Relaxed))))
}

/// Runs a future on a runtime of its own, which ends with it.
fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime").block_on(work)
}

fn bytes(rng: &mut ChaCha8Rng, size_max: usize) -> Vec<u8> {
    let mut bytes = vec![0; rng.random_range(1..=size_max)];
    rng.fill_bytes(&mut bytes);
    bytes
}

/// Contents of a store, including the checkpoint.
type StoreContents = (StoreIdentity, PersistentState, Option<Vec<u8>>);

async fn contents(store: &DurableStore) -> StoreContents {
    (store.identity(), store.load().await.expect("a log store"), store.read().await.expect("a checkpoint store"))
}

/// Writes data of every kind, and returns the expected contents.
async fn write_all_kinds(store: &DurableStore, seed: u64) -> StoreContents {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rng = &mut rng;
    let mut expected = PersistentState::default();
    let log_store: &dyn LogStore = store;
    for index in 0..60 {
        let entry = bytes(rng, 3000);
        log_store.append(vec![(index, entry.clone())]).await.expect("a write");
        expected.entries.insert(index, entry);
    }
    log_store.truncate(50).await.expect("a write");
    expected.entries.split_off(&50);
    let (vote, committed, purged, snapshot) = (bytes(rng, 40), bytes(rng, 40), bytes(rng, 40), bytes(rng, 20_000));
    let checkpoint = bytes(rng, 500);
    log_store.save_vote(vote.clone()).await.expect("a write");
    log_store.save_committed(Some(committed.clone())).await.expect("a write");
    log_store.save_snapshot(snapshot.clone()).await.expect("a write");
    log_store.purge(20, purged.clone()).await.expect("a write");
    expected.entries = expected.entries.split_off(&21);
    store.write(Some(checkpoint.clone())).await.expect("a write");
    expected.vote = Some(vote);
    expected.committed = Some(committed);
    expected.purged = Some(purged);
    expected.snapshot = Some(snapshot);
    (store.identity(), expected, Some(checkpoint))
}

#[test]
fn written_data_is_read_back_after_a_restart() {
    let folder = TempDir::new();
    let store = open(&folder).expect("a new store");
    assert_eq!(block_on(contents(&store)), (store.identity(), PersistentState::default(), None));
    let expected = block_on(write_all_kinds(&store, 1));
    assert_eq!(block_on(contents(&store)).1.entries, expected.1.entries);
    drop(store);
    for _ in 0..2 {
        let store = open(&folder).expect("the same store");
        assert_eq!(block_on(contents(&store)), expected);
    }
    // A deleted checkpoint is gone after a restart.
    let store = open(&folder).expect("the same store");
    block_on(store.write(None)).expect("a write");
    drop(store);
    assert_eq!(block_on(open(&folder).expect("the same store").read()).expect("a checkpoint store"), None);
}

#[test]
fn a_snapshot_of_any_size_replaces_the_former() {
    let folder = TempDir::new();
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for size in [300_000, 60 * 1024, 60 * 1024 + 1, 1_000_000, 120 * 1024, 300_000, 10] {
        let mut snapshot = vec![0; size];
        rng.fill_bytes(&mut snapshot);
        let store = open(&folder).expect("a store");
        block_on(store.save_snapshot(snapshot.clone())).expect("a write");
        assert!(block_on(store.load()).expect("a log store").snapshot.as_ref() == Some(&snapshot), "{size} bytes");
        snapshot.reverse();
        block_on(store.install_snapshot(snapshot.clone())).expect("a write");
        drop(store);
        let state = block_on(open(&folder).expect("the same store").load()).expect("a log store");
        assert!(state.snapshot == Some(snapshot), "{size} bytes");
    }
}

#[test]
fn an_append_does_not_wait_for_a_large_snapshot() {
    let folder = TempDir::new();
    let store = open(&folder).expect("a store");
    block_on(async {
        let mut snapshot = std::pin::pin!(store.save_snapshot(vec![7; 8 << 20]));
        let appends = async {
            for index in 0..5 {
                store.append(vec![(index, vec![8; 100])]).await.expect("a write");
            }
        };
        tokio::select! {
            biased;
            _ = &mut snapshot => panic!("the snapshot was written before the entries"),
            () = appends => {}
        }
        snapshot.await.expect("a write");
    });
    let state = block_on(store.load()).expect("a log store");
    assert_eq!((state.entries.len(), state.snapshot.map(|snapshot| snapshot.len())), (5, Some(8 << 20)));
}

/// Opens a store, and replaces it if it is damaged.
fn open_or_replace(folder: &Path, fresh: u128) -> (DurableStore, Option<Quarantine>) {
    DurableStore::open_or_replace(folder, &owner("ada"), StoreIdentity(fresh)).expect("a store")
}

#[test]
fn a_damaged_store_is_moved_away_and_replaced_by_an_empty_one() {
    let folder = TempDir::new();
    let (store, quarantine) = open_or_replace(&folder, 1);
    assert!(quarantine.is_none() && !store.replaces_damaged());
    assert_eq!(store.begin_incarnation(5000).expect("a write"), 5000);
    block_on(write_all_kinds(&store, 3));
    drop(store);
    assert!(open_or_replace(&folder, 2).1.is_none(), "an undamaged store is not replaced");

    // Two acknowledged writes are missing from the file: an older copy.
    let older = fs::read(folder.join(LEDGER_FILE)).expect("a file");
    let (store, _) = open_or_replace(&folder, 2);
    block_on(store.save_vote(vec![1])).expect("a write");
    block_on(store.save_vote(vec![2])).expect("a write");
    drop(store);
    fs::write(folder.join(LEDGER_FILE), &older).expect("a file");
    let (store, quarantine) = open_or_replace(&folder, 3);
    let Quarantine { damage, moved_to, .. } = quarantine.expect("damage");
    assert!(damage.contains("an older copy"), "{damage}");
    assert_eq!(moved_to, folder.join("damaged-1"));
    assert!(fs::read(moved_to.join(LEDGER_FILE)).expect("the former file").starts_with(b"redb"));
    assert!(moved_to.join(COMMIT_MARKER_FILE).exists());
    assert_eq!(block_on(contents(&store)), (StoreIdentity(3), PersistentState::default(), None));
    assert!(store.replaces_damaged());
    // The clock was set back as well.
    assert_eq!(store.begin_incarnation(4000).expect("a write"), 5001);
    drop(store);
    let (store, quarantine) = open_or_replace(&folder, 4);
    assert!(quarantine.is_none() && store.replaces_damaged() && store.identity() == StoreIdentity(3));
    drop(store);

    // Damaged again.
    fs::write(folder.join(LEDGER_FILE), b"redb, but nothing else").expect("a file");
    let (store, quarantine) = open_or_replace(&folder, 5);
    assert_eq!(quarantine.expect("damage").moved_to, folder.join("damaged-2"));
    assert_eq!(store.identity(), StoreIdentity(5));
}

/// Every state that an interrupted replacement leaves behind.
#[test]
fn an_interrupted_replacement_never_leaves_a_new_store() {
    let folder = TempDir::new();
    block_on(write_all_kinds(&open(&folder).expect("a store"), 4));
    let [ledger, marker] = [LEDGER_FILE, COMMIT_MARKER_FILE].map(|name| fs::read(folder.join(name)).expect("a file"));
    let damaged = &ledger[..ledger.len() / 2];
    let replacement = TempDir::new();
    fs::write(replacement.join(LEDGER_FILE), damaged).expect("a file");
    fs::write(replacement.join(COMMIT_MARKER_FILE), &marker).expect("a file");
    drop(open_or_replace(&replacement, 7));
    let new_ledger = fs::read(replacement.join(LEDGER_FILE)).expect("a file");
    let moments = [
        ("before the first move", Some(damaged), Some(&marker)),
        ("the ledger is moved", None, Some(&marker)),
        ("the new ledger is in place", Some(&new_ledger[..]), Some(&marker)),
        ("the marker is moved", Some(&new_ledger[..]), None),
    ];
    for (moment, ledger, marker) in moments {
        let folder = TempDir::new();
        fs::create_dir(folder.join("damaged-1")).expect("a folder");
        fs::write(folder.join("ledger.redb.new"), &new_ledger[..200]).expect("a file");
        if let Some(bytes) = ledger {
            fs::write(folder.join(LEDGER_FILE), bytes).expect("a file");
        }
        if let Some(bytes) = marker {
            fs::write(folder.join(COMMIT_MARKER_FILE), bytes).expect("a file");
        }
        let (store, _) = open_or_replace(&folder, 8);
        assert!(store.replaces_damaged(), "{moment}");
        assert_eq!(block_on(contents(&store)).1, PersistentState::default(), "{moment}");
    }
}

#[test]
fn a_new_store_keeps_the_identity_it_was_given() {
    let (first, second) = (TempDir::new(), TempDir::new());
    let identity = |folder: &TempDir, fresh: u128| {
        DurableStore::open(folder, &owner("ada"), StoreIdentity(fresh)).expect("a store").identity()
    };
    assert_eq!((identity(&first, 1 << 100), identity(&second, 2)), (StoreIdentity(1 << 100), StoreIdentity(2)));
    assert_eq!(identity(&first, 3), StoreIdentity(1 << 100));
}

#[test]
fn incarnations_increase_even_if_the_clock_goes_back() {
    let folder = TempDir::new();
    let begin = |wall_ms| open(&folder).expect("a store").begin_incarnation(wall_ms).expect("a write");
    assert_eq!([begin(1000), begin(2000), begin(500), begin(600), begin(3000)], [1000, 2000, 2001, 2002, 3000]);
}

#[test]
fn a_directory_serves_a_single_process_and_node() {
    let folder = TempDir::new();
    let store = open(&folder).expect("a store");
    let message = open(&folder).expect_err("a lock").to_string();
    let directory = folder.display();
    assert_eq!(
        message,
        format!("{directory}: another process uses this data directory; each node needs one of its own")
    );
    assert!(matches!(DurableStore::open_existing(&folder), Err(OpenError::InUse { .. })));
    drop(store);
    let message = DurableStore::open(&folder, &owner("bob"), StoreIdentity(1))
        .expect_err("the store of another node")
        .to_string();
    assert_eq!(
        message,
        format!(
            "{directory}/{LEDGER_FILE}: this is the store of node ada of fleet ward, not of node bob of fleet ward; each node \
             needs a data directory of its own"
        )
    );
    open(&folder).expect("the first node's store, unharmed");
}

#[test]
fn a_missing_file_is_not_created_again() {
    let folder = TempDir::new();
    drop(open(&folder).expect("a store"));
    fs::rename(folder.join(LEDGER_FILE), folder.join("elsewhere")).expect("a file");
    let message = open(&folder).expect_err("a missing file").to_string();
    let directory = folder.display();
    assert!(
        message.starts_with(&format!("{directory}/{LEDGER_FILE}: the file is missing, but {COMMIT_MARKER_FILE}")),
        "{message}"
    );
    assert!(message.contains("while a majority of the other voters is alive"), "{message}");
    assert!(message.contains("consort recover --from"), "{message}");
    assert!(!folder.join(LEDGER_FILE).exists());

    fs::rename(folder.join("elsewhere"), folder.join(LEDGER_FILE)).expect("a file");
    block_on(open(&folder).expect("a store").save_vote(vec![1])).expect("a write");
    fs::remove_file(folder.join(COMMIT_MARKER_FILE)).expect("a file");
    let message = open(&folder).expect_err("a missing commit marker").to_string();
    assert!(
        message.starts_with(&format!("{directory}/{COMMIT_MARKER_FILE}: the file is missing, but the ledger")),
        "{message}"
    );
}

#[test]
fn an_interrupted_creation_is_completed() {
    let folder = TempDir::new();
    fs::write(folder.join(format!("{LEDGER_FILE}.new")), b"half a file").expect("a file");
    let identity = open(&folder).expect("a store").identity();
    // Simulates an interruption between the creation of the ledger and that of its commit marker.
    fs::remove_file(folder.join(COMMIT_MARKER_FILE)).expect("a file");
    assert_eq!(open(&folder).expect("the same store").identity(), identity);
    assert!(folder.join(COMMIT_MARKER_FILE).exists());
    assert!(matches!(DurableStore::open_existing(&TempDir::new()), Err(OpenError::NotFound { .. })));
}

#[test]
fn an_older_copy_or_a_foreign_file_is_detected() {
    let folder = TempDir::new();
    drop(open(&folder).expect("a store"));
    fs::copy(folder.join(LEDGER_FILE), folder.join("older")).expect("a copy");
    block_on(open(&folder).expect("a store").save_vote(vec![1])).expect("a write");
    fs::copy(folder.join("older"), folder.join(LEDGER_FILE)).expect("a copy");
    let message = open(&folder).expect_err("an older copy").to_string();
    assert!(message.contains("it ends with write 1, but ledger.seal records that write 2"), "{message}");

    let second = TempDir::new();
    drop(open(&second).expect("a store"));
    fs::copy(second.join(LEDGER_FILE), folder.join(LEDGER_FILE)).expect("a copy");
    let message = open(&folder).expect_err("a foreign file").to_string();
    assert!(message.contains("it belongs to another store than ledger.seal"), "{message}");
}

/// Opens a damaged copy: it must give exactly the original contents (`true`), or an error
/// (`false`).
fn check_damaged(original: &StoreContents, folder: &TempDir, case: &str) -> bool {
    match open(folder) {
        Ok(store) => {
            assert_eq!(block_on(contents(&store)), *original, "{case}");
            true
        }
        Err(OpenError::Damaged { .. } | OpenError::WrongOwner { .. } | OpenError::Format { .. }) => false,
        Err(second) => panic!("{case}: {second}"),
    }
}

#[test]
fn a_damaged_file_gives_the_original_content_or_an_error() {
    let folder = TempDir::new();
    let original = block_on(write_all_kinds(&open(&folder).expect("a store"), 7));
    let (ledger, marker) = (
        fs::read(folder.join(LEDGER_FILE)).expect("a file"),
        fs::read(folder.join(COMMIT_MARKER_FILE)).expect("a file"),
    );
    let write_files = |ledger: &[u8], marker: &[u8]| {
        fs::write(folder.join(LEDGER_FILE), ledger).expect("a file");
        fs::write(folder.join(COMMIT_MARKER_FILE), marker).expect("a file");
    };
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut refused = 0;

    for (case, damage) in
        [("nothing", &b""[..]), ("a word", b"hello"), ("zeros", &[0; 70_000]), ("letters", &[b'x'; 9000])]
    {
        write_files(damage, &marker);
        assert!(!check_damaged(&original, &folder, case), "{case} was accepted as a ledger");
        write_files(&ledger, damage);
        assert!(!check_damaged(&original, &folder, case), "{case} was accepted as a commit marker");
    }
    let second = TempDir::new();
    drop(redb::Database::create(second.join(LEDGER_FILE)).expect("a database"));
    write_files(&fs::read(second.join(LEDGER_FILE)).expect("a file"), &marker);
    assert!(!check_damaged(&original, &folder, "a database without tables"));
    for _ in 0..40 {
        let length = rng.random_range(0..ledger.len());
        write_files(&ledger[..length], &marker);
        refused += u32::from(!check_damaged(&original, &folder, &format!("cut at {length}")));
    }
    assert_eq!(refused, 40, "every truncated file is rejected");

    // Bits of the header first; then, anywhere, bytes and ranges that are zeroed or overwritten.
    for position in (0..320).step_by(3) {
        let mut damaged = ledger.clone();
        damaged[position] ^= 1 << (position % 8);
        write_files(&damaged, &marker);
        check_damaged(&original, &folder, &format!("bit in byte {position}"));
    }
    let mut refused = 0;
    for _ in 0..120 {
        let position = rng.random_range(0..ledger.len());
        let length = if rng.random_bool(0.7) { 1 } else { rng.random_range(1..5000) }.min(ledger.len() - position);
        let zeros = rng.random_bool(0.5);
        let mut damaged = ledger.clone();
        for byte in &mut damaged[position..position + length] {
            *byte = if zeros { 0 } else { *byte ^ rng.random_range(1..=255) };
        }
        write_files(&damaged, &marker);
        refused += u32::from(!check_damaged(&original, &folder, &format!("{length} bytes from {position}")));
    }
    assert!(refused > 10, "only {refused} damaged files were rejected");
    write_files(&ledger, &marker);
    assert!(check_damaged(&original, &folder, "no damage"));
}
