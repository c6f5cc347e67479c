//! Publications of the driver server, sent in order by a task of their own: the server must stop robots in
//! time, so it never waits for the bus.

use bytes::Bytes;
use consort_bus::tasks::Tasks;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use serde::Serialize;
use tokio::sync::mpsc::{Sender, channel};
use tracing::warn;

/// Number of publications that wait for the bus. Further ones are dropped: states and events are
/// repeated.
const WAITING_MAX: usize = 256;

/// See the [module](self).
pub(super) struct Publisher(Sender<(String, Bytes)>);

impl Publisher {
    /// Creates a publisher, whose task ends with `tasks`.
    pub(super) fn start(bus: SharedBus, tasks: &mut Tasks) -> Publisher {
        let (sender, mut waiting) = channel::<(String, Bytes)>(WAITING_MAX);
        tasks.spawn(async move {
            while let Some((key, bytes)) = waiting.recv().await {
                if let Err(problem) = bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
                    warn!(%problem, "a state was not published");
                }
            }
        });
        Publisher(sender)
    }

    /// Publishes a message.
    pub(super) fn publish<T: Serialize>(&self, key: String, message: &T) {
        let bytes = Bytes::from(codec::encode(message).expect("a state fits a message"));
        if self.0.try_send((key, bytes)).is_err() {
            warn!("the bus is blocked: a state was not published");
        }
    }
}
