//! The alarm of the actor: reports the time of the next timer.

use consort_bus::clock::Clock;
use consort_protocol::units::NodeTime;
use tokio::sync::watch;

/// Alarm that was set by the actor.
pub(super) struct Alarm(watch::Sender<Option<NodeTime>>);

impl Alarm {
    /// Creates an alarm that is not set, and the task that calls `fire` at the time that was set
    /// last. The task ends when `fire` returns false.
    pub(super) fn new(clock: Clock, fire: impl Fn() -> bool + Send) -> (Alarm, impl Future<Output = ()> + Send) {
        let (alarm, alarm_set) = watch::channel(None);
        (Alarm(alarm), run(clock, alarm_set, fire))
    }

    /// Sets or clears the time of the alarm.
    pub(super) fn set(&self, due: Option<NodeTime>) {
        self.0.send_if_modified(|alarm| std::mem::replace(alarm, due) != due);
    }

    /// Notes that the alarm has fired: the next time must be set again, even if it is the same.
    pub(super) fn reset(&self) {
        self.0.send_if_modified(|alarm| alarm.take().is_none());
    }
}

async fn run(clock: Clock, mut alarm: watch::Receiver<Option<NodeTime>>, fire: impl Fn() -> bool) {
    loop {
        let due = *alarm.borrow_and_update();
        let expired = match due {
            None => false,
            Some(due) => tokio::select! {
                biased;
                changed = alarm.changed() => match changed {
                    Ok(()) => continue,
                    Err(_) => return,
                },
                () = tokio::time::sleep_until(clock.instant(due)) => true,
            },
        };
        if expired && !fire() {
            return;
        }
        // The due time has been reported; a later change sets the next time.
        if alarm.changed().await.is_err() {
            return;
        }
    }
}
