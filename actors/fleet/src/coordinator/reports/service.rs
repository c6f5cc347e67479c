//! Service of the reports of robots. A task beside the coordinator actor receives them: a lease must not wait for its renewal behind
//! auctions and other work in the mailbox of the actor.

use super::ReportHandler;
use consort_bus::tasks::Tasks;
use consort_bus::{Query, Stream, reply};
use consort_protocol::message::Report;
use std::sync::Arc;

/// Handles the reports of a session, each in a task of its own, until the bus closes.
pub(in crate::coordinator) async fn serve_reports(mut reports: Stream<Query>, handler: ReportHandler) {
    let (handler, mut tasks) = (Arc::new(handler), Tasks::default());
    while let Some(query) = reports.recv().await {
        let Some((query, report)) = reply::decode_or_refuse_in::<Report>(&mut tasks, query) else { continue };
        let handler = Arc::clone(&handler);
        tasks.spawn(async move {
            if !query.author.may_be(report.robot.as_str()) {
                let problem = format!("{} may not report for role {}", query.author, report.role);
                return reply::refuse(&query, &problem).await;
            }
            let reply = handler.handle(report).await;
            reply::wire(&query, &query.key, &reply).await;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::report;
    use super::*;
    use crate::coordinator::confirmed_time::ConfirmedTime;
    use crate::coordinator::lease_monitor::SharedLeaseMonitor;
    use crate::coordinator::message::CoordinatorMessage;
    use crate::coordinator::test_leader::TestLeader;
    use consort_bus::Bus as _;
    use consort_protocol::codec;
    use consort_protocol::keys::Key;
    use consort_protocol::lease::{EndReason, Epoch, LeaseTerms};
    use consort_protocol::message::ReportReply;
    use ractor::{Actor, ActorProcessingErr, ActorRef};
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    /// A coordinator actor that never ends the handling of its first message.
    struct Busy;

    #[ractor::async_trait]
    impl Actor for Busy {
        type Msg = CoordinatorMessage;
        type State = Arc<AtomicUsize>;
        type Arguments = Arc<AtomicUsize>;

        async fn pre_start(
            &self,
            _: ActorRef<Self::Msg>,
            begun: Self::Arguments,
        ) -> Result<Self::State, ActorProcessingErr> {
            Ok(begun)
        }

        async fn handle(
            &self,
            _: ActorRef<Self::Msg>,
            _: Self::Msg,
            begun: &mut Self::State,
        ) -> Result<(), ActorProcessingErr> {
            begun.fetch_add(1, Ordering::Relaxed);
            std::future::pending().await
        }
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn reports_are_answered_before_the_messages_in_the_mailbox() {
        let TestLeader { network, node, keys, bus, clock, replica } = TestLeader::start().await;
        let begun = Arc::new(AtomicUsize::new(0));
        let (mailbox, _) = Actor::spawn(None, Busy, Arc::clone(&begun)).await.unwrap();
        for _ in 0..1000 {
            mailbox.cast(CoordinatorMessage::Tick).unwrap();
        }
        let terms = LeaseTerms::default();
        let handler = ReportHandler {
            replica: replica.clone(),
            leadership_age_max: terms.leadership_age_max(),
            clock,
            lease_monitor: SharedLeaseMonitor::new(terms),
            mailbox,
            time: ConfirmedTime::new(node.clone(), clock, replica),
        };
        let key = keys.write(&Key::Report(node));
        tokio::spawn(serve_reports(bus.serve(&key).await.unwrap(), handler));
        let robot = network.bus("bob".parse().unwrap());
        let report = codec::encode(&report(&"visit-1".parse().unwrap(), &[])).unwrap();
        let mut answered = 0;
        for _ in 0..10 {
            let mut replies = robot.query(&key, report.clone().into(), Duration::from_secs(1)).await.unwrap();
            let reply = replies.recv().await.unwrap().payload.unwrap();
            let ended = ReportReply::Ended { epoch: Epoch::default(), reason: EndReason::Over, current: None };
            answered += usize::from(codec::decode::<ReportReply>(&reply).unwrap() == ended);
        }
        assert_eq!((answered, begun.load(Ordering::Relaxed)), (10, 1), "answered, handled by the actor");
    }
}
