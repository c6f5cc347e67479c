//! The open question of a robot to people, between the skill that asks and the reports to the
//! coordinator.

use consort_protocol::ids::TaskId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{PersonQuestion, TaskQuestion};
use consort_protocol::message::QuestionAnswer;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The open question. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct OpenQuestion(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    /// Award and task in which the robot asks.
    task: Option<(Epoch, TaskId)>,
    /// Number of questions asked in the task.
    asked: u32,
    /// The latest question.
    latest: Option<PersonQuestion>,
    /// The skill waits for its answer.
    is_open: bool,
    answer: Option<Result<String, String>>,
    /// A question was asked or closed since the last report.
    is_changed: bool,
    /// Time to wait for an answer, in seconds, of questions that state none; `None` for no limit.
    default_patience_s: Option<u32>,
}

impl OpenQuestion {
    /// Creates the state without a question. `patience_s` is the time to wait for an answer of questions that state none.
    pub(super) fn new(patience_s: Option<u32>) -> OpenQuestion {
        OpenQuestion(Arc::new(Mutex::new(State { default_patience_s: patience_s, ..State::default() })))
    }

    /// Begins an attempt at a task. Further attempts at the same task continue to count its questions:
    /// an answer counts once.
    pub(crate) fn begin_attempt(&self, epoch: Epoch, task: &TaskId) {
        let mut state = self.lock();
        state.close();
        if state.task.as_ref().is_none_or(|(of, id)| (*of, id) != (epoch, task)) {
            (state.task, state.asked, state.latest) = (Some((epoch, task.clone())), 0, None);
        }
    }

    /// Asks a question, or continues to wait for its answer.
    pub(super) fn ask(&self, question: &PersonQuestion) -> Option<Result<String, String>> {
        let mut state = self.lock();
        match state.latest.as_ref().filter(|_| state.is_open) {
            Some(open) if open == question => {
                let answer = state.answer.take()?;
                state.close();
                Some(answer)
            }
            Some(open) => Some(Err(format!("the robot already asks {}: {}", open.to, open.message))),
            None => {
                state.asked += 1;
                (state.latest, state.is_open, state.is_changed) = (Some(question.clone()), true, true);
                None
            }
        }
    }

    /// Withdraws the open question.
    pub(super) fn withdraw(&self) {
        self.lock().close();
    }

    /// Checks whether a question is open.
    pub(crate) fn is_open(&self) -> bool {
        self.lock().is_open
    }

    /// Checks whether a question was asked or closed since the last report.
    pub(crate) fn must_report(&self) -> bool {
        self.lock().is_changed
    }

    /// Returns the latest question in the task of an award for a report.
    pub(crate) fn take_report(&self, epoch: Epoch) -> Option<TaskQuestion> {
        let mut state = self.lock();
        state.is_changed = false;
        let (of, task) = state.task.clone()?;
        let mut question = state.latest.clone().filter(|_| of == epoch)?;
        question.patience_s = question.patience_s.or(state.default_patience_s);
        Some(TaskQuestion { task, number: state.asked, question, is_open: state.is_open })
    }

    /// Receives an answer. An answer to an earlier question is ignored.
    pub(crate) fn receive(&self, epoch: Epoch, answer: QuestionAnswer) {
        let QuestionAnswer { task, number, is_answered, text } = answer;
        let mut state = self.lock();
        if state.is_open && state.task == Some((epoch, task)) && state.asked == number {
            state.answer = Some(if is_answered { Ok(text) } else { Err(text) });
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic of a skill under the lock leaves no partial write: nothing in the lock panics.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn close(&mut self) {
        self.is_changed |= self.is_open;
        (self.is_open, self.answer) = (false, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AWARD: Epoch = Epoch { term: 1, index: 7 };

    fn question(message: &str) -> PersonQuestion {
        let (to, message) = ("clerk".parse().unwrap(), message.to_owned());
        PersonQuestion { to, message, at: None, patience_s: None, escalation: None }
    }

    fn begun() -> OpenQuestion {
        let open = OpenQuestion::new(None);
        open.begin_attempt(AWARD, &"visit".parse().unwrap());
        open
    }

    fn answer(number: u32, text: &str) -> QuestionAnswer {
        QuestionAnswer { task: "visit".parse().unwrap(), number, is_answered: true, text: text.to_owned() }
    }

    #[test]
    fn a_question_without_a_time_limit_is_reported_with_that_of_the_fleet() {
        for (stated, reported) in [(None, Some(3600)), (Some(60), Some(60))] {
            let open = OpenQuestion::new(Some(3600));
            open.begin_attempt(AWARD, &"visit".parse().unwrap());
            let question = PersonQuestion { patience_s: stated, ..question("may I enter?") };
            // The skill repeats the question until it is answered.
            assert_eq!([open.ask(&question), open.ask(&question)], [None, None]);
            assert_eq!(open.take_report(AWARD).unwrap().question.patience_s, reported);
        }
    }

    #[test]
    fn a_question_is_open_until_its_answer_is_taken() {
        let open = begun();
        assert_eq!(open.ask(&question("may I enter?")), None);
        assert!(open.is_open() && open.must_report());
        let reported = open.take_report(AWARD).unwrap();
        assert_eq!((reported.number, reported.question.message.as_str(), reported.is_open), (1, "may I enter?", true));
        assert!(!open.must_report());
        assert_eq!(open.take_report(Epoch { index: 8, ..AWARD }), None, "another award");
        open.receive(AWARD, answer(2, "to another question"));
        assert_eq!(open.ask(&question("may I enter?")), None);
        open.receive(AWARD, answer(1, "yes"));
        assert_eq!(open.ask(&question("may I enter?")), Some(Ok("yes".to_owned())));
        assert!(!open.is_open());
    }

    #[test]
    fn the_same_question_in_a_later_attempt_is_another_question() {
        let open = begun();
        open.ask(&question("may I enter?"));
        open.receive(AWARD, answer(1, "no"));
        open.ask(&question("may I enter?"));
        open.begin_attempt(AWARD, &"visit".parse().unwrap());
        assert_eq!(open.ask(&question("may I enter?")), None);
        assert_eq!(open.take_report(AWARD).unwrap().number, 2);
        open.begin_attempt(AWARD, &"leave".parse().unwrap());
        assert!(!open.is_open() && open.must_report());
        assert_eq!(open.take_report(AWARD), None, "the ledger withdraws the question of a task that has ended");
        open.ask(&question("may I enter?"));
        assert_eq!(open.take_report(AWARD).unwrap().number, 1);
    }

    #[test]
    fn a_robot_asks_one_question_at_a_time() {
        let open = begun();
        open.ask(&question("may I enter?"));
        let second = open.ask(&question("are you well?"));
        assert_eq!(second, Some(Err("the robot already asks clerk: may I enter?".to_owned())));
        open.withdraw();
        assert!(!open.take_report(AWARD).unwrap().is_open, "the coordinator withdraws it");
        assert_eq!(open.ask(&question("are you well?")), None);
    }
}
