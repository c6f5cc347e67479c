//! Tokio for openraft, with chance that repeats and limits that bear slow disks.
//!
//! openraft draws exactly one random number: the election timeout, once, when a node is built, on the thread that
//! builds it and before anything is awaited. [`seed_elections`] is called just before that, so that nothing in a node
//! is left to chance. (The timeout itself goes unused: see `canvass`.)
//!
//! openraft limits its questions, too. It derives the limit of a request for a vote from the time for which voters refuse
//! candidates, and before it answers the voter has brought its vote to disk: a fleet whose disks take longer than that could
//! elect nobody. So no question's limit is below [`APPEND_MAX`]; `network` sets stricter ones where they serve.

use super::settings::APPEND_TIMEOUT;
use openraft::{AsyncRuntime, TokioRuntime};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::cell::RefCell;
use std::future::Future;
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::time::Duration;

thread_local! {
    static CHANCE: RefCell<ChaCha8Rng> =
        // A thread nobody seeded: the standard library's hasher keys come from the operating system.
        RefCell::new(ChaCha8Rng::seed_from_u64(RandomState::new().build_hasher().finish()));
}

/// Makes the election timeouts of the Raft nodes that this thread builds from now on follow from `seed`.
pub fn seed_elections(seed: u64) {
    CHANCE.with_borrow_mut(|chance| *chance = ChaCha8Rng::seed_from_u64(seed));
}

/// openraft's view of this thread's seeded generator.
#[derive(Debug)]
pub struct ElectionChance(());

impl rand08::RngCore for ElectionChance {
    fn next_u32(&mut self) -> u32 {
        CHANCE.with_borrow_mut(|chance| chance.next_u32())
    }

    fn next_u64(&mut self) -> u64 {
        CHANCE.with_borrow_mut(|chance| chance.next_u64())
    }

    fn fill_bytes(&mut self, bytes: &mut [u8]) {
        CHANCE.with_borrow_mut(|chance| chance.fill_bytes(bytes));
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), rand08::Error> {
        self.fill_bytes(bytes);
        Ok(())
    }
}

/// [`TokioRuntime`] with a seeded generator, and with limits of `APPEND_MAX` at least. Time and tasks are tokio's, so
/// paused time works.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct SeededRuntime;

impl AsyncRuntime for SeededRuntime {
    type JoinError = <TokioRuntime as AsyncRuntime>::JoinError;
    type JoinHandle<T: Send + 'static> = <TokioRuntime as AsyncRuntime>::JoinHandle<T>;
    type Sleep = <TokioRuntime as AsyncRuntime>::Sleep;
    type Instant = <TokioRuntime as AsyncRuntime>::Instant;
    type TimeoutError = <TokioRuntime as AsyncRuntime>::TimeoutError;
    type Timeout<R, T: Future<Output = R> + Send> = <TokioRuntime as AsyncRuntime>::Timeout<R, T>;
    type ThreadLocalRng = ElectionChance;
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
        ElectionChance(())
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
