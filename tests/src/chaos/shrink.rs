//! Cuts a schedule down to what matters: delta debugging (Zeller and Hildebrandt, *Simplifying and isolating
//! failure-inducing input*, 2002), then shorter faults.

use super::schedule::{Schedule, ScheduledAction};

/// The smallest schedule found for which `fails` is still true, trying at most so often. `fails` must be true of
/// `schedule`, and is asked again about nothing twice in a row.
pub fn shrink(schedule: &Schedule, tries_max: usize, mut fails: impl FnMut(&Schedule) -> bool) -> Schedule {
    let mut tries = 0;
    let mut still = |steps: &[ScheduledAction]| {
        tries += 1;
        tries <= tries_max && fails(&Schedule { steps: steps.to_vec() })
    };
    let mut steps = schedule.steps.clone();
    drop_parts(&mut steps, &mut still);
    shorten(&mut steps, &mut still);
    Schedule { steps }
}

/// Halves, quarters and so on, down to single steps, until none can be spared.
fn drop_parts(steps: &mut Vec<ScheduledAction>, still: &mut impl FnMut(&[ScheduledAction]) -> bool) {
    let mut size = steps.len().div_ceil(2);
    while size > 0 && !steps.is_empty() {
        let mut from = 0;
        let mut spared = false;
        while from < steps.len() {
            let to = (from + size).min(steps.len());
            let rest: Vec<ScheduledAction> = steps[..from].iter().chain(&steps[to..]).cloned().collect();
            if still(&rest) {
                *steps = rest;
                spared = true;
            } else {
                from = to;
            }
        }
        // Once a part could be spared, others that could not may be now.
        if !spared || size > 1 {
            size = if size == 1 { 0 } else { size.div_ceil(2) };
        }
    }
}

/// Each fault half as long, as often as that still does it.
fn shorten(steps: &mut [ScheduledAction], still: &mut impl FnMut(&[ScheduledAction]) -> bool) {
    for number in 0..steps.len() {
        while let Some(for_ms) = steps[number].action.for_ms().filter(|ms| *ms >= 200) {
            let longer = steps[number].clone();
            steps[number].action = longer.action.with_duration_ms(for_ms / 2);
            if !still(steps) {
                steps[number] = longer;
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::schedule::ChaosAction;

    fn pause(at_ms: u64, node: &str) -> ScheduledAction {
        ScheduledAction { at_ms, action: ChaosAction::Pause { node: node.to_owned(), for_ms: 10_000 } }
    }

    #[test]
    fn only_the_steps_that_matter_are_left_and_last_no_longer_than_they_must() {
        let steps = (0..23).map(|n| pause(n, &format!("n{n}"))).collect();
        let lasts = |schedule: &Schedule, node: &str| {
            let step =
                schedule.steps.iter().find(|s| matches!(&s.action, ChaosAction::Pause { node: n, .. } if n == node));
            step.and_then(|step| step.action.for_ms()).unwrap_or(0)
        };
        let found = shrink(&Schedule { steps }, 1_000, |s| lasts(s, "n4") >= 2_000 && lasts(s, "n17") >= 100);
        let expected = [pause(4, "n4").action.with_duration_ms(2_500), pause(17, "n17").action.with_duration_ms(156)];
        assert_eq!(found.steps.iter().map(|step| step.action.clone()).collect::<Vec<_>>(), expected);
    }
}
