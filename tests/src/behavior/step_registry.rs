//! All step patterns, and the resolution of steps.

use super::own_steps::OwnSteps;
use super::step_arguments::StepArguments;
use super::step_meaning::{FactCheck, StepMeaning};
use super::step_pattern::{ActionStep, FactStep, SettingStep, StepPattern};
use super::{
    fleet_actions, fleet_facts, goal_actions, item_facts, mission_requests, own_steps, passage_facts, robot_facts,
    settings,
};
use cucumber::gherkin::{Step, StepType};
use std::sync::OnceLock;

/// The patterns.
pub(super) struct StepRegistry {
    settings: Vec<SettingStep>,
    shipped_actions: Vec<ActionStep>,
    shipped_facts: Vec<FactStep>,
    own: &'static OwnSteps,
}

/// Documentation of a step pattern.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepDoc {
    /// Its heading.
    pub kind: &'static str,
    /// The pattern, with parameters in braces.
    pub pattern: String,
    /// An example.
    pub example: String,
}

/// Forms of facts after `Then` and `When`, and of actions after `Given`.
const FORMS: [(&str, &str); 8] = [
    ("Given {action} when {fact}", "Given the coordinator is killed when task navto_lab has begun"),
    ("When {action}", "When the coordinator is killed"),
    ("When the fleet runs until {fact}", r#"When the fleet runs until amber is at "Dock""#),
    ("Then {fact}", r#"Then amber is at "Dock""#),
    ("Then it is not true that {fact}", r#"Then it is not true that amber is at "Dock""#),
    ("Then within {time} {fact}", "Then within 20 s there is a coordinator"),
    ("Then for {time} {fact}", r#"Then for 2 minutes amber is at "Dock""#),
    (
        "Then for {time} it is never true that {fact}",
        "Then for 2 minutes it is never true that there is no coordinator",
    ),
];

impl StepRegistry {
    /// Returns the registry.
    pub(super) fn get() -> &'static StepRegistry {
        static REGISTRY: OnceLock<StepRegistry> = OnceLock::new();
        REGISTRY.get_or_init(|| StepRegistry {
            settings: settings::steps(),
            shipped_actions: [mission_requests::steps(), fleet_actions::steps(), goal_actions::steps()]
                .into_iter()
                .flatten()
                .collect(),
            shipped_facts: [fleet_facts::steps(), robot_facts::steps(), item_facts::steps(), passage_facts::steps()]
                .into_iter()
                .flatten()
                .collect(),
            own: own_steps::added(),
        })
    }

    fn actions(&self) -> impl Iterator<Item = &ActionStep> {
        self.shipped_actions.iter().chain(&self.own.actions)
    }

    fn facts(&self) -> impl Iterator<Item = &FactStep> {
        self.shipped_facts.iter().chain(&self.own.facts)
    }

    /// Resolves a step.
    ///
    /// # Errors
    /// The step is unknown or ambiguous.
    pub(super) fn read(&'static self, step: &Step) -> Result<StepMeaning, UnresolvedStep> {
        let text = step.value.trim();
        let more = |values| StepArguments {
            values,
            table: step.table.as_ref().map(|table| table.rows.clone()),
            docstring: step.docstring.clone(),
        };
        let checks = |text: &str| -> Vec<FactCheck> {
            let matching = self.facts().filter_map(|fact| Some((fact.function, fact.parse(text)?)));
            matching.map(|(fact, values)| FactCheck { fact, arguments: more(values), text: text.to_owned() }).collect()
        };
        let actions = |text: &str| -> Vec<(&'static ActionStep, StepArguments)> {
            let matching = self.actions().filter_map(|action| Some((action, action.parse(text)?)));
            matching.map(|(action, values)| (action, more(values))).collect()
        };
        let mut candidates = vec![];
        match step.ty {
            StepType::Given => {
                let matching =
                    self.settings.iter().filter_map(|setting| Some((setting.function, setting.parse(text)?)));
                candidates.extend(matching.map(|(setting, values)| StepMeaning::Configure(setting, more(values))));
                for (at, _) in text.match_indices(" when ") {
                    let (action, fact) = (&text[..at], &text[at + " when ".len()..]);
                    for (action, arguments) in actions(action) {
                        let planned = checks(fact)
                            .into_iter()
                            .map(|check| StepMeaning::DoWhen(action, arguments.clone(), Box::new(check)));
                        candidates.extend(planned);
                    }
                }
            }
            StepType::When => {
                candidates
                    .extend(actions(text).into_iter().map(|(action, arguments)| StepMeaning::DoNow(action, arguments)));
                if let Some(fact) = text.strip_prefix("the fleet runs until ") {
                    candidates.extend(checks(fact).into_iter().map(StepMeaning::WaitUntil));
                }
            }
            StepType::Then => {
                candidates.extend(checks(text).into_iter().map(StepMeaning::Holds));
                if let Some(fact) = text.strip_prefix("it is not true that ") {
                    candidates.extend(checks(fact).into_iter().map(StepMeaning::DoesNotHold));
                }
                if let Some((seconds, fact)) = timed(text, "within ") {
                    candidates.extend(checks(fact).into_iter().map(|check| StepMeaning::HoldsWithin(seconds, check)));
                }
                if let Some((seconds, fact)) = timed(text, "for ") {
                    candidates.extend(checks(fact).into_iter().map(|check| StepMeaning::HoldsFor(seconds, check)));
                    if let Some(fact) = fact.strip_prefix("it is never true that ") {
                        candidates
                            .extend(checks(fact).into_iter().map(|check| StepMeaning::NeverHolds(seconds, check)));
                    }
                }
            }
        }
        match candidates.len() {
            1 => Ok(candidates.remove(0)),
            0 => Err(UnresolvedStep::Unknown { similar: self.nearest(step) }),
            patterns => Err(UnresolvedStep::Ambiguous { patterns }),
        }
    }

    /// Returns the three most similar examples, each on its own line.
    fn nearest(&self, step: &Step) -> String {
        let keyword = keyword(step.ty);
        let wanted = format!("{keyword} {}", step.value.trim());
        let mut near: Vec<(f64, String)> = vec![];
        for doc in step_docs() {
            for example in with_keywords(keyword, &doc) {
                near.push((strsim::sorensen_dice(&wanted, &example), example));
            }
        }
        near.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        near.dedup();
        let lines: Vec<String> = near.into_iter().take(3).map(|(_, example)| format!("    {example}")).collect();
        lines.join("\n")
    }
}

/// Reason why a step has no meaning.
#[derive(Debug, thiserror::Error)]
pub(super) enum UnresolvedStep {
    #[error("unknown step; similar steps are\n{similar}")]
    Unknown { similar: String },
    #[error("this step is ambiguous: {patterns} patterns match")]
    Ambiguous { patterns: usize },
}

/// Parses a time after a word. Returns the time in seconds and the rest of the text.
fn timed<'a>(text: &'a str, word: &str) -> Option<(f64, &'a str)> {
    static TIME: OnceLock<StepPattern<()>> = OnceLock::new();
    let time = TIME.get_or_init(|| StepPattern::new("{time}", "2 min", ()));
    let rest = text.strip_prefix(word)?;
    let unit = rest.find(' ')? + 1;
    let end = unit + rest[unit..].find(' ')?;
    let values = time.parse(&rest[..end])?;
    Some((StepArguments { values, ..StepArguments::default() }.seconds(0), &rest[end + 1..]))
}

fn keyword(ty: StepType) -> &'static str {
    match ty {
        StepType::Given => "Given",
        StepType::When => "When",
        StepType::Then => "Then",
    }
}

/// Returns an example after a keyword, if it can follow that keyword.
fn with_keywords(keyword: &str, doc: &StepDoc) -> Vec<String> {
    match (doc.kind, keyword) {
        (SETTINGS, "Given") | (ACTIONS, "When") | (FACTS, "Then") => vec![format!("{keyword} {}", doc.example)],
        (ACTIONS, "Given") => vec![format!("Given {} when the mission is running", doc.example)],
        (FACTS, "When") => vec![format!("When the fleet runs until {}", doc.example)],
        (FORMS_KIND, _) if doc.example.starts_with(keyword) => vec![doc.example.clone()],
        _ => vec![],
    }
}

const FORMS_KIND: &str = "Forms of a step";
const SETTINGS: &str = "Settings, after Given";
const ACTIONS: &str = "Actions";
const FACTS: &str = "Facts";

/// Returns the documentation of all steps.
pub fn step_docs() -> Vec<StepDoc> {
    fn list<'a, T: 'a>(kind: &'static str, patterns: impl Iterator<Item = &'a StepPattern<T>>) -> Vec<StepDoc> {
        let doc = |step: &StepPattern<T>| StepDoc {
            kind,
            pattern: step.pattern.to_owned(),
            example: step.example.to_owned(),
        };
        patterns.map(doc).collect()
    }
    let registry = StepRegistry::get();
    let form = |(pattern, example): (&str, &str)| StepDoc {
        kind: FORMS_KIND,
        pattern: pattern.to_owned(),
        example: example.to_owned(),
    };
    let mut all: Vec<StepDoc> = FORMS.into_iter().map(form).collect();
    all.extend(list(SETTINGS, registry.settings.iter()));
    all.extend(list(ACTIONS, registry.actions()));
    all.extend(list(FACTS, registry.facts()));
    all
}
