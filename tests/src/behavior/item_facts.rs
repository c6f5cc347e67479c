//! Facts about items and people.

use super::fixture::Fixture;
use super::robot_facts::names_text;
use super::step_arguments::name;
use super::step_pattern::{FactStep, fact};
use super::step_result::{StepFailure, StepResult, expect_that};
use consort_world::world::{SampleHolder, SampleReport};

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<FactStep> {
    vec![arm_holds(), is_in_drawer(), lies_at(), is_still_with(), sample_was_delivered(), nurse_is_away()]
}

fn arm_holds() -> FactStep {
    fact("{name} holds {text}", r#"lab-arm holds "sample of IC Room 6""#, |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        check_holder(fixture, arguments.value(1), &SampleHolder::Arm(robot))
    })
}

fn is_in_drawer() -> FactStep {
    fact(
        "{text} is in the drawer of {name}",
        r#""sample of IC Room 6" is in the drawer of amber"#,
        |fixture, arguments| {
            let robot = fixture.robot(arguments.value(1))?;
            check_holder(fixture, arguments.value(0), &SampleHolder::Drawer(robot))
        },
    )
}

fn lies_at() -> FactStep {
    fact("{text} lies at {text}", r#""tray" lies at "Laboratory""#, |fixture, arguments| {
        check_holder(fixture, arguments.value(0), &SampleHolder::Table(name(arguments.value(1))?))
    })
}

fn is_still_with() -> FactStep {
    fact(
        "{text} is still with {text}",
        r#""sample of IC Room 6" is still with "nurse of IC Room 6""#,
        |fixture, arguments| {
            check_holder(fixture, arguments.value(0), &SampleHolder::Person(arguments.value(1).into()))
        },
    )
}

fn sample_was_delivered() -> FactStep {
    fact(
        "the sample of {text} was delivered to {name}",
        r#"the sample of "IC Room 6" was delivered to lab-arm"#,
        |fixture, arguments| {
            let (robot, id) = (fixture.robot(arguments.value(1))?, format!("sample of {}", arguments.value(0)));
            let report = sample(fixture, &id)?;
            let mut holders: Vec<&SampleHolder> = report.history.iter().map(|(_, holder)| holder).collect();
            holders.push(&report.holder);
            // An arm lays down what it holds when the next sample arrives.
            holders.pop_if(|last| matches!(last, SampleHolder::Table(_)));
            let delivered = matches!(holders[..], [SampleHolder::Person(_), SampleHolder::Drawer(_), SampleHolder::Arm(arm)] if *arm == robot);
            expect_that(delivered, || {
                let hands: Vec<String> = holders.into_iter().map(holder_text).collect();
                format!("it was {}", hands.join(", then "))
            })
        },
    )
}

fn nurse_is_away() -> FactStep {
    fact("the nurse in {text} is away", r#"the nurse in "IC Room 6" is away"#, |fixture, arguments| {
        let people = fixture.with_world(|world| world.people());
        let person = people.iter().find(|person| person.place.as_str() == arguments.value(0));
        let person =
            person.ok_or_else(|| StepFailure::Invalid(format!("there is no person for {:?}", arguments.value(0))))?;
        expect_that(person.away, || "she is there".to_owned())
    })
}

fn sample(fixture: &Fixture, id: &str) -> Result<SampleReport, StepFailure> {
    let found = fixture.with_world(|world| world.sample(&id.into()));
    found.ok_or_else(|| {
        let known = fixture.with_world(|world| world.samples());
        let known: Vec<String> = known.iter().map(|sample| sample.id.as_str().to_owned()).collect();
        StepFailure::Invalid(format!("there is no {id:?}; there are: {}", names_text(&known)))
    })
}

fn check_holder(fixture: &Fixture, id: &str, wanted: &SampleHolder) -> StepResult {
    let holder = sample(fixture, id)?.holder;
    expect_that(holder == *wanted, || format!("it is {}", holder_text(&holder)))
}

fn holder_text(holder: &SampleHolder) -> String {
    match holder {
        SampleHolder::Table(place) => format!("on the table at {place}"),
        SampleHolder::Drawer(robot) => format!("in the drawer of {robot}"),
        SampleHolder::Arm(robot) => format!("in the arm of {robot}"),
        SampleHolder::Person(person) => format!("with {}", person.as_str()),
    }
}
