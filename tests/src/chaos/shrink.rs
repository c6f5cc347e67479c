//! Shrinking of schedules: delta debugging (Zeller and Hildebrandt, *Simplifying and isolating
//! failure-inducing input*, 2002), followed by shorter faults.

use super::schedule::{Schedule, ScheduledAction};

/// Returns the smallest schedule found for which `fails` still returns true, with at most
/// `tries_max` tries. `fails` must be true of `schedule`. It is not called twice in a row with the
/// same schedule.
pub fn shrink(schedule: &Schedule, tries_max: usize, mut fails: impl FnMut(&Schedule) -> bool) -> Schedule {
    let mut tries = 0;
    let mut still = |steps: &[ScheduledAction]| {
        tries += 1;
        tries <= tries_max && fails(&schedule.with_steps(steps.to_vec()))
    };
    let mut steps = schedule.steps.clone();
    drop_parts(&mut steps, &mut still);
    shorten(&mut steps, &mut still);
    schedule.with_steps(steps)
}

/// Drops halves, quarters and so on, down to single actions, until all remaining actions are
/// necessary.
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
        // After a part was dropped, parts that were necessary before may be dropped now.
        if !spared || size > 1 {
            size = if size == 1 { 0 } else { size.div_ceil(2) };
        }
    }
}

/// Halves the duration of each fault as long as the failure persists.
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
    fn shrinking_keeps_only_necessary_actions_and_durations() {
        let steps = (0..23).map(|n| pause(n, &format!("n{n}"))).collect();
        let lasts = |schedule: &Schedule, node: &str| {
            let step =
                schedule.steps.iter().find(|s| matches!(&s.action, ChaosAction::Pause { node: n, .. } if n == node));
            step.and_then(|step| step.action.for_ms()).unwrap_or(0)
        };
        let found = shrink(&Schedule::of(steps), 1_000, |s| lasts(s, "n4") >= 2_000 && lasts(s, "n17") >= 100);
        let expected = [pause(4, "n4").action.with_duration_ms(2_500), pause(17, "n17").action.with_duration_ms(156)];
        assert_eq!(found.steps.iter().map(|step| step.action.clone()).collect::<Vec<_>>(), expected);
    }
}
