//! Runtimes with virtual clocks that advance together, in a single thread.

use crate::paused_runtime;
use rustix::time::{ClockId, clock_gettime};
use std::cell::{Cell, RefCell};
use std::pin::pin;
use std::rc::Rc;
use std::time::Duration;
use tokio::runtime::{Handle, Runtime};
use tokio::time::{Instant, advance, sleep_until};

/// Time by which the clocks advance at once.
const STEP: Duration = Duration::from_millis(1);

/// A main runtime, and separate runtimes, which measure the computing time of parts of the fleet.
pub(super) struct Runtimes {
    main: Runtime,
    separate: RefCell<Vec<SeparateRuntime>>,
}

/// Runtime that measures its computing time.
#[derive(Clone)]
pub(super) struct SeparateRuntime {
    runtime: Rc<Runtime>,
    cpu: Rc<Cell<Duration>>,
}

impl SeparateRuntime {
    /// Returns the handle with which futures are spawned on the runtime.
    pub(super) fn handle(&self) -> Handle {
        self.runtime.handle().clone()
    }

    /// Returns the computing time so far.
    pub(super) fn cpu(&self) -> Duration {
        self.cpu.get()
    }

    fn run_until(&self, time: Instant) {
        let before = thread_time();
        self.runtime.block_on(async { sleep_until(time).await });
        self.cpu.set(self.cpu.get() + (thread_time() - before));
    }
}

impl Runtimes {
    pub(super) fn new() -> Runtimes {
        Runtimes { main: paused_runtime(), separate: RefCell::default() }
    }

    /// Adds a separate runtime.
    pub(super) fn separate(&self) -> SeparateRuntime {
        let runtime = SeparateRuntime { runtime: Rc::new(paused_runtime()), cpu: Rc::default() };
        self.separate.borrow_mut().push(runtime.clone());
        runtime
    }

    /// Runs a future on the main runtime, and all runtimes meanwhile, in turn for each step of the
    /// clock.
    pub(super) fn block_on<T>(&self, work: impl Future<Output = T>) -> T {
        let mut work = pin!(work);
        let mut time = self.align();
        loop {
            time += STEP;
            let done = self.main.block_on(async {
                tokio::select! {
                    biased;
                    result = &mut work => Some(result),
                    () = sleep_until(time) => None,
                }
            });
            if let Some(result) = done {
                return result;
            }
            for separate in self.separate.borrow().iter() {
                separate.run_until(time);
            }
        }
    }

    /// Sets all clocks to the latest, and returns it: each began when its runtime was created.
    fn align(&self) -> Instant {
        let separate = self.separate.borrow();
        let all = || std::iter::once(&self.main).chain(separate.iter().map(|separate| &*separate.runtime));
        let now = |runtime: &Runtime| runtime.block_on(async { Instant::now() });
        let latest = all().map(now).max().expect("there is a main runtime");
        all().for_each(|runtime| runtime.block_on(async { advance(latest - Instant::now()).await }));
        latest
    }
}

/// Returns the computing time of this thread.
fn thread_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}
