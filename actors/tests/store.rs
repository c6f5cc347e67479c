//! A store on disk: what is read back is what was written, or an error; never something else, never nothing.

use consort_actors::raft::{LogStore, PersistentState, StoreIdentity};
use consort_actors::store::{COMMIT_MARKER_FILE, CheckpointStore, DurableStore, LEDGER_FILE, OpenError, StoreOwner};
use consort_protocol::ids::{FleetId, NodeId};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

#[path = "store/crash.rs"]
mod crash;
#[path = "store/hindered.rs"]
mod hindered;
#[path = "store/replica.rs"]
mod replica;
#[path = "store/snapshot_first.rs"]
mod snapshot_first;

/// A folder of its own for each test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Folder {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("consort-store-{}-{count}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder");
        Folder(path)
    }
}

impl std::ops::Deref for Folder {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn owner(node: &str) -> StoreOwner {
    StoreOwner { fleet: FleetId::new("ward").expect("a slug"), node: NodeId::new(node).expect("a slug") }
}

fn open(folder: &Path) -> Result<DurableStore, OpenError> {
    // Another name each time: it counts at the creation alone.
    static COUNT: AtomicU64 = AtomicU64::new(1);
    DurableStore::open(folder, &owner("ada"), StoreIdentity(u128::from(COUNT.fetch_add(1, Ordering::Relaxed))))
}

/// Runs what is written and read with a runtime of its own, which ends with it.
fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime").block_on(work)
}

fn bytes(rng: &mut ChaCha8Rng, most: usize) -> Vec<u8> {
    let mut bytes = vec![0; rng.random_range(1..=most)];
    rng.fill_bytes(&mut bytes);
    bytes
}

/// What a store holds, its notebook included.
type Held = (StoreIdentity, PersistentState, Option<Vec<u8>>);

async fn held(store: &DurableStore) -> Held {
    (store.identity(), store.load().await.expect("a journal"), store.read().await.expect("a page"))
}

/// Writes something of every kind, and tells what must be there afterwards.
async fn write_some(store: &DurableStore, seed: u64) -> Held {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rng = &mut rng;
    let mut expected = PersistentState::default();
    let journal: &dyn LogStore = store;
    for index in 0..60 {
        let entry = bytes(rng, 3000);
        journal.append(vec![(index, entry.clone())]).await.expect("a write");
        expected.entries.insert(index, entry);
    }
    journal.truncate(50).await.expect("a write");
    expected.entries.split_off(&50);
    let (vote, committed, purged, snapshot) = (bytes(rng, 40), bytes(rng, 40), bytes(rng, 40), bytes(rng, 20_000));
    let page = bytes(rng, 500);
    journal.save_vote(vote.clone()).await.expect("a write");
    journal.save_committed(Some(committed.clone())).await.expect("a write");
    journal.save_snapshot(snapshot.clone()).await.expect("a write");
    journal.purge(20, purged.clone()).await.expect("a write");
    expected.entries = expected.entries.split_off(&21);
    store.write(Some(page.clone())).await.expect("a write");
    expected.vote = Some(vote);
    expected.committed = Some(committed);
    expected.purged = Some(purged);
    expected.snapshot = Some(snapshot);
    (store.identity(), expected, Some(page))
}

#[test]
fn what_was_written_is_read_back_in_the_next_life() {
    let folder = Folder::new();
    let store = open(&folder).expect("a new store");
    assert_eq!(block_on(held(&store)), (store.identity(), PersistentState::default(), None));
    let expected = block_on(write_some(&store, 1));
    assert_eq!(block_on(held(&store)).1.entries, expected.1.entries);
    drop(store);
    for _ in 0..2 {
        let store = open(&folder).expect("the same store");
        assert_eq!(block_on(held(&store)), expected);
    }
    // A page that was torn out is no page.
    let store = open(&folder).expect("the same store");
    block_on(store.write(None)).expect("a write");
    drop(store);
    assert_eq!(block_on(open(&folder).expect("the same store").read()).expect("a page"), None);
}

#[test]
fn each_new_store_has_the_name_that_it_is_given_and_keeps_it() {
    let (one, other) = (Folder::new(), Folder::new());
    let name = |folder: &Folder, fresh: u128| {
        DurableStore::open(folder, &owner("ada"), StoreIdentity(fresh)).expect("a store").identity()
    };
    assert_eq!((name(&one, 1 << 100), name(&other, 2)), (StoreIdentity(1 << 100), StoreIdentity(2)));
    assert_eq!(name(&one, 3), StoreIdentity(1 << 100));
}

#[test]
fn each_life_is_larger_than_the_last_even_if_the_clock_went_back() {
    let folder = Folder::new();
    let begin = |wall_ms| open(&folder).expect("a store").begin_incarnation(wall_ms).expect("a write");
    assert_eq!([begin(1000), begin(2000), begin(500), begin(600), begin(3000)], [1000, 2000, 2001, 2002, 3000]);
}

#[test]
fn a_directory_serves_one_process_and_one_node() {
    let folder = Folder::new();
    let store = open(&folder).expect("a store");
    let message = open(&folder).expect_err("a lock").to_string();
    let place = folder.display();
    assert_eq!(message, format!("{place}: another process uses this data directory; each node needs one of its own"));
    assert!(matches!(DurableStore::open_existing(&folder), Err(OpenError::InUse { .. })));
    drop(store);
    let message = DurableStore::open(&folder, &owner("bob"), StoreIdentity(1)).expect_err("another's").to_string();
    assert_eq!(
        message,
        format!(
            "{place}/{LEDGER_FILE}: this is the store of node ada of fleet ward, not of node bob of fleet ward; each node \
             needs a data directory of its own"
        )
    );
    open(&folder).expect("the first node's store, unharmed");
}

#[test]
fn a_file_that_is_gone_is_not_begun_anew() {
    let folder = Folder::new();
    drop(open(&folder).expect("a store"));
    fs::rename(folder.join(LEDGER_FILE), folder.join("elsewhere")).expect("a file");
    let message = open(&folder).expect_err("a file that is gone").to_string();
    let place = folder.display();
    assert!(
        message.starts_with(&format!("{place}/{LEDGER_FILE}: it is gone, though {COMMIT_MARKER_FILE} beside it says")),
        "{message}"
    );
    assert!(message.contains("as long as a majority of the other voters lives"), "{message}");
    assert!(message.contains("consort recover --from"), "{message}");
    assert!(!folder.join(LEDGER_FILE).exists());

    fs::rename(folder.join("elsewhere"), folder.join(LEDGER_FILE)).expect("a file");
    block_on(open(&folder).expect("a store").save_vote(vec![1])).expect("a write");
    fs::remove_file(folder.join(COMMIT_MARKER_FILE)).expect("a file");
    let message = open(&folder).expect_err("a seal that is gone").to_string();
    assert!(
        message.starts_with(&format!("{place}/{COMMIT_MARKER_FILE}: it is gone, though the ledger beside it")),
        "{message}"
    );
}

#[test]
fn a_creation_that_was_interrupted_is_made_good() {
    let folder = Folder::new();
    fs::write(folder.join(format!("{LEDGER_FILE}.new")), b"half a file").expect("a file");
    let identity = open(&folder).expect("a store").identity();
    // Cut between the naming of the ledger and that of its seal.
    fs::remove_file(folder.join(COMMIT_MARKER_FILE)).expect("a file");
    assert_eq!(open(&folder).expect("the same store").identity(), identity);
    assert!(folder.join(COMMIT_MARKER_FILE).exists());
    assert!(matches!(DurableStore::open_existing(&Folder::new()), Err(OpenError::NotFound { .. })));
}

#[test]
fn an_older_copy_or_the_file_of_another_store_is_told_from_the_last() {
    let folder = Folder::new();
    drop(open(&folder).expect("a store"));
    fs::copy(folder.join(LEDGER_FILE), folder.join("older")).expect("a copy");
    block_on(open(&folder).expect("a store").save_vote(vec![1])).expect("a write");
    fs::copy(folder.join("older"), folder.join(LEDGER_FILE)).expect("a copy");
    let message = open(&folder).expect_err("an older copy").to_string();
    assert!(message.contains("it ends with write 1, though ledger.seal beside it says that write 2"), "{message}");

    let other = Folder::new();
    drop(open(&other).expect("a store"));
    fs::copy(other.join(LEDGER_FILE), folder.join(LEDGER_FILE)).expect("a copy");
    let message = open(&folder).expect_err("another's file").to_string();
    assert!(message.contains("it is of another store than ledger.seal beside it"), "{message}");
}

/// What opening a damaged copy gives: exactly what was there, or an error.
fn check_damaged(whole: &Held, folder: &Folder, what: &str) -> bool {
    match open(folder) {
        Ok(store) => {
            assert_eq!(block_on(held(&store)), *whole, "{what}");
            true
        }
        Err(OpenError::Damaged { .. } | OpenError::WrongOwner { .. } | OpenError::Format { .. }) => false,
        Err(other) => panic!("{what}: {other}"),
    }
}

#[test]
fn a_damaged_file_gives_what_was_there_or_an_error() {
    let folder = Folder::new();
    let whole = block_on(write_some(&open(&folder).expect("a store"), 7));
    let (ledger, seal) = (
        fs::read(folder.join(LEDGER_FILE)).expect("a file"),
        fs::read(folder.join(COMMIT_MARKER_FILE)).expect("a file"),
    );
    let put = |ledger: &[u8], seal: &[u8]| {
        fs::write(folder.join(LEDGER_FILE), ledger).expect("a file");
        fs::write(folder.join(COMMIT_MARKER_FILE), seal).expect("a file");
    };
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut refused = 0;

    for (what, content) in
        [("nothing", &b""[..]), ("a word", b"hello"), ("zeros", &[0; 70_000]), ("letters", &[b'x'; 9000])]
    {
        put(content, &seal);
        assert!(!check_damaged(&whole, &folder, what), "{what} was taken for a ledger");
        put(&ledger, content);
        assert!(!check_damaged(&whole, &folder, what), "{what} was taken for a seal");
    }
    let other = Folder::new();
    drop(redb::Database::create(other.join(LEDGER_FILE)).expect("a database"));
    put(&fs::read(other.join(LEDGER_FILE)).expect("a file"), &seal);
    assert!(!check_damaged(&whole, &folder, "a database without tables"));
    for _ in 0..40 {
        let length = rng.random_range(0..ledger.len());
        put(&ledger[..length], &seal);
        refused += u32::from(!check_damaged(&whole, &folder, &format!("cut at {length}")));
    }
    assert_eq!(refused, 40, "a file that was cut is never whole");

    // The header, byte by byte; then bytes, and stretches that were never written or were written by another, anywhere.
    for place in (0..320).step_by(3) {
        let mut damaged = ledger.clone();
        damaged[place] ^= 1 << (place % 8);
        put(&damaged, &seal);
        check_damaged(&whole, &folder, &format!("bit in byte {place}"));
    }
    let mut refused = 0;
    for _ in 0..120 {
        let place = rng.random_range(0..ledger.len());
        let length = if rng.random_bool(0.7) { 1 } else { rng.random_range(1..5000) }.min(ledger.len() - place);
        let zeros = rng.random_bool(0.5);
        let mut damaged = ledger.clone();
        for byte in &mut damaged[place..place + length] {
            *byte = if zeros { 0 } else { *byte ^ rng.random_range(1..=255) };
        }
        put(&damaged, &seal);
        refused += u32::from(!check_damaged(&whole, &folder, &format!("{length} bytes from {place}")));
    }
    assert!(refused > 10, "{refused}: hardly any damage was found");
    put(&ledger, &seal);
    assert!(check_damaged(&whole, &folder, "no damage"));
}
