//! All that may be said, and what a step means.

use super::step_arguments::StepArguments;
use super::step_pattern::{ActionFn, FactFn, SettingFn, StepPattern};
use super::{fleet_actions, fleet_facts, goal_actions, mission_requests, robot_facts, settings};
use cucumber::gherkin::{Step, StepType};
use std::sync::OnceLock;

/// The phrases.
pub(super) struct StepRegistry {
    settings: Vec<StepPattern<SettingFn>>,
    deeds: Vec<StepPattern<ActionFn>>,
    facts: Vec<StepPattern<FactFn>>,
}

/// What a step means.
#[derive(Debug, Clone)]
pub(super) enum StepMeaning {
    /// Something is there from the beginning.
    Configure(SettingFn, StepArguments),
    /// Something will be done once a fact holds.
    DoWhen(ActionFn, StepArguments, Box<FactCheck>),
    /// Something is done now.
    DoNow(ActionFn, StepArguments),
    /// Time passes until a fact holds.
    WaitUntil(FactCheck),
    /// A fact holds now.
    Holds(FactCheck),
    /// It does not.
    DoesNotHold(FactCheck),
    /// A fact holds after some time at the latest, in seconds.
    HoldsWithin(f64, FactCheck),
    /// A fact holds throughout some time.
    HoldsFor(f64, FactCheck),
    /// A fact does not hold at any moment of some time.
    NeverHolds(f64, FactCheck),
}

/// A fact that is looked at.
#[derive(Debug, Clone)]
pub(super) struct FactCheck {
    pub(super) fact: FactFn,
    pub(super) arguments: StepArguments,
    /// In words.
    pub(super) text: String,
}

/// Something that may be said, for people who look for words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepDoc {
    /// Under which heading it stands.
    pub kind: &'static str,
    /// What may be said, with parameters in braces.
    pub pattern: String,
    /// An example.
    pub example: String,
}

/// How facts are said after `Then` and `When`, and deeds after `Given`.
const FORMS: [(&str, &str); 8] = [
    ("Given {deed} when {fact}", "Given the coordinator dies when task navto_lab has begun"),
    ("When {deed}", "When the coordinator dies"),
    ("When the fleet runs until {fact}", r#"When the fleet runs until amber is at "Dock""#),
    ("Then {fact}", r#"Then amber is at "Dock""#),
    ("Then it is not so that {fact}", r#"Then it is not so that amber is at "Dock""#),
    ("Then within {time} {fact}", "Then within 20 s somebody coordinates"),
    ("Then for {time} {fact}", r#"Then for 2 minutes amber is at "Dock""#),
    ("Then for {time} it is never so that {fact}", "Then for 2 minutes it is never so that nobody coordinates"),
];

impl StepRegistry {
    /// The one there is.
    pub(super) fn get() -> &'static StepRegistry {
        static BOOK: OnceLock<StepRegistry> = OnceLock::new();
        BOOK.get_or_init(|| StepRegistry {
            settings: settings::phrases(),
            deeds: [mission_requests::phrases(), fleet_actions::phrases(), goal_actions::phrases()]
                .into_iter()
                .flatten()
                .collect(),
            facts: [fleet_facts::phrases(), robot_facts::phrases()].into_iter().flatten().collect(),
        })
    }

    /// What a step means.
    ///
    /// # Errors
    /// What is wrong with it, in words: nobody knows such a step, or it is ambiguous.
    pub(super) fn read(&self, step: &Step) -> Result<StepMeaning, String> {
        let text = step.value.trim();
        let more = |words| StepArguments {
            values: words,
            table: step.table.as_ref().map(|table| table.rows.clone()),
            docstring: step.docstring.clone(),
        };
        let looks = |text: &str| -> Vec<FactCheck> {
            let fits = self.facts.iter().filter_map(|fact| Some((fact.function, fact.parse(text)?)));
            fits.map(|(fact, words)| FactCheck { fact, arguments: more(words), text: text.to_owned() }).collect()
        };
        let deeds = |text: &str| -> Vec<(ActionFn, StepArguments)> {
            let fits = self.deeds.iter().filter_map(|deed| Some((deed.function, deed.parse(text)?)));
            fits.map(|(deed, words)| (deed, more(words))).collect()
        };
        let mut meanings = vec![];
        match step.ty {
            StepType::Given => {
                let fits = self.settings.iter().filter_map(|setting| Some((setting.function, setting.parse(text)?)));
                meanings.extend(fits.map(|(setting, words)| StepMeaning::Configure(setting, more(words))));
                for (at, _) in text.match_indices(" when ") {
                    let (deed, fact) = (&text[..at], &text[at + " when ".len()..]);
                    for (deed, said) in deeds(deed) {
                        let arranged =
                            looks(fact).into_iter().map(|look| StepMeaning::DoWhen(deed, said.clone(), Box::new(look)));
                        meanings.extend(arranged);
                    }
                }
            }
            StepType::When => {
                meanings.extend(deeds(text).into_iter().map(|(deed, said)| StepMeaning::DoNow(deed, said)));
                if let Some(fact) = text.strip_prefix("the fleet runs until ") {
                    meanings.extend(looks(fact).into_iter().map(StepMeaning::WaitUntil));
                }
            }
            StepType::Then => {
                meanings.extend(looks(text).into_iter().map(StepMeaning::Holds));
                if let Some(fact) = text.strip_prefix("it is not so that ") {
                    meanings.extend(looks(fact).into_iter().map(StepMeaning::DoesNotHold));
                }
                if let Some((seconds, fact)) = timed(text, "within ") {
                    meanings.extend(looks(fact).into_iter().map(|look| StepMeaning::HoldsWithin(seconds, look)));
                }
                if let Some((seconds, fact)) = timed(text, "for ") {
                    meanings.extend(looks(fact).into_iter().map(|look| StepMeaning::HoldsFor(seconds, look)));
                    if let Some(fact) = fact.strip_prefix("it is never so that ") {
                        meanings.extend(looks(fact).into_iter().map(|look| StepMeaning::NeverHolds(seconds, look)));
                    }
                }
            }
        }
        match meanings.len() {
            1 => Ok(meanings.remove(0)),
            0 => Err(format!("nobody knows this step; the nearest are\n{}", self.nearest(step))),
            many => Err(format!("this step can be understood in {many} ways")),
        }
    }

    /// The three examples that are most alike, a line each.
    fn nearest(&self, step: &Step) -> String {
        let keyword = keyword(step.ty);
        let wanted = format!("{keyword} {}", step.value.trim());
        let mut near: Vec<(f64, String)> = vec![];
        for listed in step_docs() {
            for example in with_keywords(keyword, &listed) {
                near.push((strsim::sorensen_dice(&wanted, &example), example));
            }
        }
        near.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        near.dedup();
        let lines: Vec<String> = near.into_iter().take(3).map(|(_, example)| format!("    {example}")).collect();
        lines.join("\n")
    }
}

/// A time after a word, in seconds, and what follows it.
fn timed<'a>(text: &'a str, word: &str) -> Option<(f64, &'a str)> {
    static TIME: OnceLock<StepPattern<()>> = OnceLock::new();
    let time = TIME.get_or_init(|| StepPattern::new("{time}", "2 min", ()));
    let rest = text.strip_prefix(word)?;
    let unit = rest.find(' ')? + 1;
    let end = unit + rest[unit..].find(' ')?;
    let words = time.parse(&rest[..end])?;
    Some((StepArguments { values: words, ..StepArguments::default() }.seconds(0), &rest[end + 1..]))
}

fn keyword(ty: StepType) -> &'static str {
    match ty {
        StepType::Given => "Given",
        StepType::When => "When",
        StepType::Then => "Then",
    }
}

/// An example as it is said after a keyword, if it can be.
fn with_keywords(keyword: &str, listed: &StepDoc) -> Vec<String> {
    match (listed.kind, keyword) {
        (SETTINGS, "Given") | (DEEDS, "When") | (FACTS, "Then") => vec![format!("{keyword} {}", listed.example)],
        (DEEDS, "Given") => vec![format!("Given {} when the mission is running", listed.example)],
        (FACTS, "When") => vec![format!("When the fleet runs until {}", listed.example)],
        (FORMS_OF, _) if listed.example.starts_with(keyword) => vec![listed.example.clone()],
        _ => vec![],
    }
}

const FORMS_OF: &str = "Forms of a step";
const SETTINGS: &str = "Settings, after Given";
const DEEDS: &str = "Deeds";
const FACTS: &str = "Facts";

/// All that may be said.
pub fn step_docs() -> Vec<StepDoc> {
    fn list<T: Copy>(kind: &'static str, phrases: &[StepPattern<T>]) -> Vec<StepDoc> {
        let listed = |phrase: &StepPattern<T>| StepDoc {
            kind,
            pattern: phrase.pattern.to_owned(),
            example: phrase.example.to_owned(),
        };
        phrases.iter().map(listed).collect()
    }
    let book = StepRegistry::get();
    let form = |(pattern, example): (&str, &str)| StepDoc {
        kind: FORMS_OF,
        pattern: pattern.to_owned(),
        example: example.to_owned(),
    };
    let mut all: Vec<StepDoc> = FORMS.into_iter().map(form).collect();
    all.extend(list(SETTINGS, &book.settings));
    all.extend(list(DEEDS, &book.deeds));
    all.extend(list(FACTS, &book.facts));
    all
}
