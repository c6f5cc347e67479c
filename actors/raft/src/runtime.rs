//! Tokio runtime for openraft, with a seeded random generator and with timeouts that tolerate slow
//! disks.
//!
//! openraft draws a single random number: the election timeout, once, when a node is built, on the
//! thread that builds it and before the first await. [`seed_elections`] is called just before that,
//! so that a node is deterministic. (The timeout itself is unused: see `election`.)
//!
//! openraft also limits the time of its requests. It derives the limit of a vote request from the
//! time for which voters reject candidates. A voter writes its vote to disk before it replies: a
//! fleet with disks slower than that limit could not elect a leader. So the limit of every request
//! is at least [`APPEND_TIMEOUT`]; `network` sets stricter limits where they help.

use super::settings::APPEND_TIMEOUT;
use openraft::{AsyncRuntime, TokioRuntime};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::cell::RefCell;
use std::future::Future;
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::time::Duration;

thread_local! {
    static RNG: RefCell<ChaCha8Rng> =
        // Default for a thread that was not seeded: the hasher keys of the standard library come
        // from the operating system.
        RefCell::new(ChaCha8Rng::seed_from_u64(RandomState::new().build_hasher().finish()));
}

/// Seeds the election timeouts of the Raft nodes that this thread builds from now on.
pub(super) fn seed_elections(seed: u64) {
    RNG.with_borrow_mut(|rng| *rng = ChaCha8Rng::seed_from_u64(seed));
}

/// Random generator of openraft: this thread's seeded generator.
#[derive(Debug)]
pub(super) struct ElectionRng(());

impl rand08::RngCore for ElectionRng {
    fn next_u32(&mut self) -> u32 {
        RNG.with_borrow_mut(|rng| rng.next_u32())
    }

    fn next_u64(&mut self) -> u64 {
        RNG.with_borrow_mut(|rng| rng.next_u64())
    }

    fn fill_bytes(&mut self, bytes: &mut [u8]) {
        RNG.with_borrow_mut(|rng| rng.fill_bytes(bytes));
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), rand08::Error> {
        self.fill_bytes(bytes);
        Ok(())
    }
}

/// [`TokioRuntime`] with a seeded generator, and with timeouts of at least `APPEND_TIMEOUT`. Time
/// and tasks are those of tokio, so paused time works.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct SeededRuntime;

impl AsyncRuntime for SeededRuntime {
    type JoinError = <TokioRuntime as AsyncRuntime>::JoinError;
    type JoinHandle<T: Send + 'static> = <TokioRuntime as AsyncRuntime>::JoinHandle<T>;
    type Sleep = <TokioRuntime as AsyncRuntime>::Sleep;
    type Instant = <TokioRuntime as AsyncRuntime>::Instant;
    type TimeoutError = <TokioRuntime as AsyncRuntime>::TimeoutError;
    type Timeout<R, T: Future<Output = R> + Send> = <TokioRuntime as AsyncRuntime>::Timeout<R, T>;
    type ThreadLocalRng = ElectionRng;
    type OneshotSender<T: Send> = <TokioRuntime as AsyncRuntime>::OneshotSender<T>;
    type OneshotReceiverError = <TokioRuntime as AsyncRuntime>::OneshotReceiverError;
    type OneshotReceiver<T: Send> = <TokioRuntime as AsyncRuntime>::OneshotReceiver<T>;

    fn spawn<T>(future: T) -> Self::JoinHandle<T::Output>
    where
        T: Future + Send + 'static,
        T::Output: Send + 'static,
    {
        TokioRuntime::spawn(future)
    }

    fn sleep(duration: Duration) -> Self::Sleep {
        TokioRuntime::sleep(duration)
    }

    fn sleep_until(deadline: Self::Instant) -> Self::Sleep {
        TokioRuntime::sleep_until(deadline)
    }

    fn timeout<R, F: Future<Output = R> + Send>(duration: Duration, future: F) -> Self::Timeout<R, F> {
        TokioRuntime::timeout(duration.max(APPEND_TIMEOUT), future)
    }

    fn timeout_at<R, F: Future<Output = R> + Send>(deadline: Self::Instant, future: F) -> Self::Timeout<R, F> {
        TokioRuntime::timeout_at(deadline, future)
    }

    fn is_panic(join_error: &Self::JoinError) -> bool {
        TokioRuntime::is_panic(join_error)
    }

    fn thread_rng() -> Self::ThreadLocalRng {
        ElectionRng(())
    }

    fn oneshot<T: Send>() -> (Self::OneshotSender<T>, Self::OneshotReceiver<T>) {
        TokioRuntime::oneshot()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeouts(seed: u64) -> Vec<u64> {
        let config = openraft::Config { election_timeout_min: 150, election_timeout_max: 300, ..Default::default() };
        seed_elections(seed);
        (0..8).map(|_| config.new_rand_election_timeout::<SeededRuntime>()).collect()
    }

    #[test]
    fn election_timeouts_follow_from_the_seed_and_stay_within_their_bounds() {
        assert_eq!(timeouts(1), timeouts(1));
        assert_ne!(timeouts(1), timeouts(2));
        assert!(timeouts(3).iter().all(|ms| (150..300).contains(ms)), "{:?}", timeouts(3));
    }
}
