//! Untrusted input is read or rejected: quickly, with little memory, on the stack of a worker, and
//! never with a panic.
//!
//! Each [target](targets) receives its seeds, the inputs in `tests/fuzz/corpus/` (each was a
//! failure once or is a known attack), and seeded mutations of both. `CONSORT_FUZZ_CASES` sets
//! the number of mutations and `CONSORT_FUZZ_SEED` their seed. `CONSORT_FUZZ_SEEDS=DIR`
//! writes the seeds into a folder per target, as the initial corpus of `tests/fuzz/run.sh`.

mod golden_bytes;
mod mutate;
mod regressions;
mod seeds;
mod targets;

use mutate::Mutator;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use targets::Target;

/// Stack size of tokio workers, which read the input.
const STACK: usize = 2 << 20;

/// Limit for a single input. Tests are not optimised.
const SOON: Duration = Duration::from_secs(10);

/// Limit for additional memory of a target, in bytes. The largest accepted input is some megabytes,
/// and may need that much more once it is parsed.
const MEMORY: u64 = 512 << 20;

/// Default number of mutations per target.
const CASES: u64 = 600;

macro_rules! target_tests {
    ($($name:ident)*) => {
        const TESTED: &[&str] = &[$(stringify!($name)),*];
        $(#[test] fn $name() { run_target(stringify!($name)); })*
    };
}

target_tests! {
    wire signed_envelope certificate pem names gossip raft award checkpoint ledger store request mission_yaml mission_json ihtn domain driver
    map_yaml map_json drawing building layout tree condition feature config design calibration tables recording fleet_model dashboard
}

#[test]
fn every_target_has_a_test_and_a_fuzz_program() {
    let names: Vec<&str> = targets::ALL.iter().map(|target| target.name).collect();
    assert_eq!(TESTED, names);
    let manifest = fs::read_to_string(fuzz().join("Cargo.toml")).expect("the fuzz crate");
    for name in names {
        assert!(manifest.contains(&format!("name = \"{name}\"")), "{name} is no fuzz target");
        let program = fs::read_to_string(fuzz().join(format!("fuzz_targets/{name}.rs"))).expect("its program");
        assert!(program.contains(&format!("hit(\"{name}\"")), "{name}: {program}");
    }
}

fn target(name: &str) -> &'static Target {
    targets::ALL.iter().find(|target| target.name == name).expect("a target of that name")
}

fn fuzz() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz")
}

/// Returns the inputs in the corpus.
fn corpus(name: &str) -> Vec<Vec<u8>> {
    let Ok(folder) = fs::read_dir(fuzz().join("corpus").join(name)) else { return vec![] };
    let mut files: Vec<PathBuf> = folder.map(|file| file.expect("a file").path()).collect();
    files.sort();
    files.iter().map(|file| fs::read(file).expect("a kept input")).collect()
}

fn number(variable: &str, otherwise: u64) -> u64 {
    match std::env::var(variable) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{variable} is {text:?}; allowed is a number")),
        Err(_) => otherwise,
    }
}

fn run_target(name: &str) {
    // The peak of the memory is that of the whole process, so the targets run in sequence.
    static MEASURED: Mutex<()> = Mutex::new(());
    let _measured = MEASURED.lock().unwrap_or_else(PoisonError::into_inner);
    let target = target(name);
    let seeds = seeds::for_target(name);
    if let Ok(folder) = std::env::var("CONSORT_FUZZ_SEEDS") {
        let folder = Path::new(&folder).join(name);
        fs::create_dir_all(&folder).expect("a folder");
        for (nth, seed) in seeds.iter().enumerate() {
            fs::write(folder.join(format!("seed-{nth}")), seed).expect("a file");
        }
    }
    let corpus = corpus(name);
    let (cases, seed) = (number("CONSORT_FUZZ_CASES", CASES), number("CONSORT_FUZZ_SEED", 1));
    let trial = Trial { target, last: Mutex::default() };
    let before = peak();
    let outcome = thread::scope(|scope| {
        let all = || {
            for (nth, seed) in seeds.iter().enumerate() {
                assert!(trial.case(seed), "seed {nth} contains nothing valid");
            }
            for input in &corpus {
                trial.case(input);
            }
            let mut mutator = Mutator::new(name, seed, seeds.iter().chain(&corpus));
            for _ in 0..cases {
                trial.case(&mutator.next());
            }
        };
        thread::Builder::new()
            .stack_size(STACK)
            .name(name.to_owned())
            .spawn_scoped(scope, all)
            .expect("a thread")
            .join()
    });
    if outcome.is_err() {
        let input = trial.last.lock().unwrap_or_else(PoisonError::into_inner);
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{name}"));
        fs::write(&file, &*input).expect("a file");
        let words = String::from_utf8_lossy(&input[..input.len().min(400)]).into_owned();
        panic!("{name}: failed, see above; the input ({} bytes) is in {}: {words:?}", input.len(), file.display());
    }
    let grown = peak().saturating_sub(before);
    assert!(grown <= MEMORY, "{name} took {} MiB of memory, where {} are allowed", grown >> 20, MEMORY >> 20);
}

struct Trial {
    target: &'static Target,
    /// The current input.
    last: Mutex<Vec<u8>>,
}

impl Trial {
    /// Reads an input. Returns whether any part of it was valid.
    fn case(&self, input: &[u8]) -> bool {
        input.clone_into(&mut self.last.lock().unwrap_or_else(PoisonError::into_inner));
        let began = Instant::now();
        let read = (self.target.run)(input);
        let took = began.elapsed();
        assert!(took < SOON, "it took {took:?}, where {SOON:?} are allowed");
        read
    }
}

/// Returns the peak memory of this process in bytes; 0 where the system does not report it.
fn peak() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
    kibibytes.unwrap_or(0) * 1024
}
