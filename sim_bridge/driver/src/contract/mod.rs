//! The actions that a driver may offer, and the check of its hello; the readings that it may send.

use crate::messages::{OfferedAction, PROTOCOL_VERSION};
use consort_protocol::ids::ActionName;
use consort_protocol::mission::ValueKind;
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{ActionError, ErrorCode, GoalResult};
use consort_skills::domain::standard_domain;
use consort_skills::domain_file::{ActionForm, CancelForm, DomainFile, ParameterForm};
use consort_text::{AllowedNames, shorten};
use std::collections::BTreeMap;
use std::time::Duration;

/// Maximum size of the name or the value of a reading or a feedback in an error, in bytes.
const SHOWN_BYTES_MAX: usize = 80;

/// The actions and the readings that domain files declare, the standard domain included.
#[derive(Debug, Clone, Default)]
pub struct Contract {
    declared: BTreeMap<ActionName, ActionForm>,
    readings: BTreeMap<String, ValueKind>,
}

/// A reading was rejected: the value before it stays valid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReadingError {
    /// No domain declares the reading.
    #[error("readings: values.{name}: no domain declares this reading; {allowed}")]
    Undeclared {
        /// The name.
        name: String,
        /// The allowed names, with the nearest.
        allowed: String,
    },
    /// The value does not fit the declaration.
    #[error("readings: values.{name}: `{value}`; the domain declares {kind}")]
    Value {
        /// The name.
        name: String,
        /// The value, as text.
        value: String,
        /// The declared values, as text.
        kind: String,
    },
}

/// Values of a feedback were dropped. The goal continues, with the other values.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FeedbackError {
    /// The action does not declare the value.
    #[error("feedback: values.{name}: the action {action} declares no such feedback; {allowed}")]
    Undeclared {
        /// The action.
        action: ActionName,
        /// The name.
        name: String,
        /// The allowed names, with the nearest.
        allowed: String,
    },
    /// The value does not fit the declaration.
    #[error("feedback: values.{name}: `{value}`; the action {action} declares {kind}")]
    Value {
        /// The action.
        action: ActionName,
        /// The name.
        name: String,
        /// The value, as text.
        value: String,
        /// The declared values, as text.
        kind: String,
    },
    /// The declared values together are too long.
    #[error("feedback: values: {bytes} bytes of JSON; at most {} are allowed", GoalResult::BYTES_MAX)]
    TooLong {
        /// Size.
        bytes: usize,
    },
}

/// The hello of a driver was rejected: its goals are not started.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ContractError {
    /// The driver has another version of the messages.
    #[error("hello: protocol: {0} is not supported; allowed: {PROTOCOL_VERSION}")]
    Protocol(u32),
    /// The driver offers nothing.
    #[error(
        "hello: actions: the list is empty; allowed are the actions of the standard domain and of the files of --domain"
    )]
    NoActions,
    /// No domain declares an action.
    #[error("hello: actions.{action}: no domain declares this action; {allowed}")]
    Undeclared {
        /// The action.
        action: ActionName,
        /// The allowed names, with the nearest.
        allowed: String,
    },
    /// A parameter, a result or a feedback differs from the declaration.
    #[error("hello: actions.{action}.{place}: {problem}")]
    Value {
        /// The action.
        action: ActionName,
        /// `parameters.NAME`, `results.NAME` or `feedback.NAME`.
        place: String,
        /// The problem, and what is allowed.
        problem: String,
    },
}

impl Contract {
    /// Returns the contract of the standard domain and these domains.
    pub fn new<'a>(domains: impl IntoIterator<Item = &'a DomainFile>) -> Contract {
        let mut contract = Contract::default();
        for domain in [standard_domain()].into_iter().chain(domains) {
            contract.declared.extend(domain.action_forms().map(|(name, form)| (name.clone(), form.clone())));
            let readings = domain.reading_forms().map(|(name, form)| (name.clone(), form.value.value_kind()));
            contract.readings.extend(readings);
        }
        contract
    }

    /// Returns a reading in the declared type.
    ///
    /// # Errors
    /// No domain declares the reading, or not with this value.
    pub fn accept_reading(&self, name: &str, value: &Scalar) -> Result<Scalar, ReadingError> {
        let shown = |text: &str| shorten(text, SHOWN_BYTES_MAX).into_owned();
        let Some(kind) = self.readings.get(name) else {
            let allowed = AllowedNames::suggest_for(name, self.readings.keys()).to_string();
            return Err(ReadingError::Undeclared { name: shown(name), allowed });
        };
        kind.accept(value).ok_or_else(|| ReadingError::Value {
            name: name.to_owned(),
            value: shown(&value.to_string()),
            kind: kind.to_string(),
        })
    }

    /// Returns the values of a feedback that the action declares, in the declared types, and the problems of the
    /// others. Without a problem these are all values.
    pub(crate) fn accept_feedback(
        &self,
        action: &ActionName,
        values: &BTreeMap<String, Scalar>,
    ) -> (BTreeMap<String, Scalar>, Vec<FeedbackError>) {
        let (mut accepted, mut problems) = (BTreeMap::new(), vec![]);
        for (name, value) in values {
            match self.accept_feedback_value(action, name, value) {
                Ok(value) => drop(accepted.insert(name.clone(), value)),
                Err(problem) => problems.push(problem),
            }
        }
        let bytes = serde_json::to_string(&accepted).map_or(usize::MAX, |text| text.len());
        if bytes > GoalResult::BYTES_MAX {
            accepted.clear();
            problems.push(FeedbackError::TooLong { bytes });
        }
        (accepted, problems)
    }

    fn accept_feedback_value(&self, action: &ActionName, name: &str, value: &Scalar) -> Result<Scalar, FeedbackError> {
        let shown = |text: &str| shorten(text, SHOWN_BYTES_MAX).into_owned();
        let declared = self.declared.get(action);
        let Some(form) = declared.and_then(|form| form.feedback.get(name)) else {
            let names = declared.into_iter().flat_map(|form| form.feedback.keys());
            let allowed = AllowedNames::suggest_for(name, names).to_string();
            return Err(FeedbackError::Undeclared { action: action.clone(), name: shown(name), allowed });
        };
        let kind = form.value_kind();
        kind.accept(value).ok_or_else(|| FeedbackError::Value {
            action: action.clone(),
            name: name.to_owned(),
            value: shown(&value.to_string()),
            kind: kind.to_string(),
        })
    }

    /// Returns the results of an action.
    pub(crate) fn results(&self, action: &ActionName) -> impl Iterator<Item = (&String, &ParameterForm)> {
        self.declared.get(action).into_iter().flat_map(|form| &form.results)
    }

    /// Returns the declared time from a cancel to the end of a goal.
    pub(crate) fn cancel_limit(&self, action: &ActionName) -> Option<Duration> {
        let CancelForm { within_s } = self.declared.get(action)?.cancel.as_ref()?;
        Duration::try_from_secs_f64(*within_s).ok()
    }

    /// Checks the content of a hello.
    ///
    /// # Errors
    /// The first difference from the declarations.
    pub fn check(&self, protocol: u32, actions: &BTreeMap<ActionName, OfferedAction>) -> Result<(), ContractError> {
        if protocol != PROTOCOL_VERSION {
            return Err(ContractError::Protocol(protocol));
        }
        if actions.is_empty() {
            return Err(ContractError::NoActions);
        }
        for (name, offered) in actions {
            let Some(declared) = self.declared.get(name) else {
                let allowed = AllowedNames::suggest_for(name.as_str(), self.declared.keys()).to_string();
                return Err(ContractError::Undeclared { action: name.clone(), allowed });
            };
            check_values(["parameters", "parameter"], &declared.parameters, offered.parameters.as_ref())
                .and_then(|()| check_values(["results", "result"], &declared.results, offered.results.as_ref()))
                .and_then(|()| check_values(["feedback"; 2], &declared.feedback, offered.feedback.as_ref()))
                .map_err(|(place, problem)| ContractError::Value { action: name.clone(), place, problem })?;
        }
        Ok(())
    }

    /// Returns the error of a goal that a driver aborted with this code. The code is a failure that the action
    /// declares, or a standard one. For any other code it is an error without a code, with the problem.
    pub(crate) fn failure(&self, action: &str, code: Option<&str>, message: &str) -> (ActionError, Option<String>) {
        let declared = ActionName::new(action).ok().and_then(|name| self.declared.get(&name));
        let Some(code) = code else { return (ActionError::new(ErrorCode::Failed, message), None) };
        if let Some(error) = declared.and_then(|form| form.failure(code, message)) {
            return (error, None);
        }
        if let Some(standard) = ErrorCode::ALL.iter().find(|standard| standard.as_str() == code) {
            return (ActionError::new(*standard, message), None);
        }
        let names = declared.into_iter().flat_map(|form| form.failures.keys()).map(String::as_str);
        let allowed = AllowedNames::suggest_for(code, names.chain(ErrorCode::ALL.iter().map(|code| code.as_str())));
        let problem = format!("result: code: {action} has no failure `{code}`; {allowed}");
        (ActionError::new(ErrorCode::Failed, message), Some(problem))
    }
}

/// Compares the parameters, the results or the feedback of an action, if the driver states them: every declared
/// one that is not optional is offered, and each has the declared type. An error is the place and the problem. The
/// first argument is the key of the values, and the word for one of them.
fn check_values(
    [key, what]: [&str; 2],
    declared: &BTreeMap<String, ParameterForm>,
    offered: Option<&BTreeMap<String, ParameterForm>>,
) -> Result<(), (String, String)> {
    let Some(offered) = offered else { return Ok(()) };
    let place = |name: &String| format!("{key}.{name}");
    for (name, parameter) in offered {
        let Some(form) = declared.get(name) else {
            let allowed = AllowedNames::suggest_for(name, declared.keys());
            return Err((place(name), format!("the domain declares no such {what}; {allowed}")));
        };
        if form.kind != parameter.kind {
            let kind = serde_json::to_value(form.kind).unwrap_or_default();
            return Err((place(name), format!("type: the domain declares {kind}")));
        }
    }
    match declared.iter().find(|(name, form)| !form.optional && !offered.contains_key(*name)) {
        Some((missing, _)) => Err((place(missing), "is missing; the domain declares it".to_owned())),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
