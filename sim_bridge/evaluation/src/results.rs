//! Results as CSV: a row for each trial.

use super::calibration::Observation;
use super::outcome::EndState;
use super::policy::Policy;
use consort_protocol::ids::TaskId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fault injected into the fleet during a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Treatment {
    /// No fault.
    Calm,
    /// The coordinator is killed at a random moment.
    CoordinatorKilled,
}

impl Treatment {
    /// All treatments.
    pub const ALL: [Treatment; 2] = [Treatment::Calm, Treatment::CoordinatorKilled];

    /// Returns the name used in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Treatment::Calm => "calm",
            Treatment::CoordinatorKilled => "coordinator-killed",
        }
    }
}

/// A trial. The names of the fields are the CSV header, in this order; unknown values are empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialRow {
    /// Name of the trial, unique in the design.
    pub trial: String,
    /// The mission.
    pub mission: String,
    /// The scenario.
    pub scenario: String,
    /// Level of the factor speed; empty in scenarios without levels.
    pub speed: String,
    /// Level of the factor charge.
    pub charge: String,
    /// Level of the factor discharge rate.
    pub discharge: String,
    /// Level of the factor location.
    pub location: String,
    /// Level of the factor skills.
    pub skills: String,
    /// The policy.
    pub policy: Policy,
    /// The injected fault.
    pub treatment: Treatment,
    /// Number of the repetition, from 1.
    pub repetition: u32,
    /// The end state.
    pub end_state: EndState,
    /// Time to conclude in seconds of world time; successes only.
    pub ttc_s: Option<f64>,
    /// Longest time of the accepted bids, in seconds.
    pub predicted_s: Option<f64>,
    /// Lowest charge of an assigned mobile robot, as a share of a full battery.
    pub lowest_share: Option<f64>,
    /// The last task that a managed role began.
    pub last_task: Option<TaskId>,
    /// The chosen robots by role: `r1=ada lab_arm=arm`.
    pub robots: String,
    /// Further remarks.
    pub note: String,
}

/// Writes rows with a header.
///
/// # Errors
/// [`csv::Error`] of the writer.
pub fn write(rows: &[TrialRow], to: impl std::io::Write) -> Result<(), csv::Error> {
    let mut writer = csv::Writer::from_writer(to);
    for row in rows {
        writer.serialize(row)?;
    }
    writer.flush()?;
    Ok(())
}

/// Writes observations with a header: the actual and the estimated time and energy of each task.
///
/// # Errors
/// [`csv::Error`] of the writer.
pub fn write_observations(observations: &[Observation], to: impl std::io::Write) -> Result<(), csv::Error> {
    let mut writer = csv::Writer::from_writer(to);
    for observation in observations {
        writer.serialize(observation)?;
    }
    writer.flush()?;
    Ok(())
}

/// Reads the output of [`write()`].
///
/// # Errors
/// [`csv::Error`] with line and field, also for an unknown or missing column.
pub fn read(from: impl std::io::Read) -> Result<Vec<TrialRow>, csv::Error> {
    csv::Reader::from_reader(from).into_deserialize().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> TrialRow {
        let level = |name: &str| name.to_owned();
        TrialRow {
            trial: "lab-samples/aaaab/consort/calm/1".into(),
            mission: "lab-samples".into(),
            scenario: "aaaab".into(),
            speed: level("a"),
            charge: level("a"),
            discharge: level("a"),
            location: level("b"),
            skills: level("a"),
            policy: Policy::Consort,
            treatment: Treatment::CoordinatorKilled,
            repetition: 1,
            end_state: EndState::Success,
            ttc_s: Some(0.1 + 0.2),
            predicted_s: None,
            lowest_share: Some(0.31),
            last_task: Some("close_drawer_lab".parse().unwrap()),
            robots: "r1=ada lab_arm=arm".into(),
            note: "two, \"three\"".into(),
        }
    }

    #[test]
    fn written_rows_are_read_back_exactly() {
        let rows = [row(), TrialRow { end_state: EndState::TimeoutSim, ttc_s: None, last_task: None, ..row() }];
        let mut text = vec![];
        write(&rows, &mut text).unwrap();
        assert_eq!(read(text.as_slice()).unwrap(), rows);
        let header = String::from_utf8(text).unwrap().lines().next().unwrap().to_owned();
        assert_eq!(
            header,
            "trial,mission,scenario,speed,charge,discharge,location,skills,policy,treatment,repetition,end_state,ttc_s,\
             predicted_s,lowest_share,last_task,robots,note"
        );
    }

    #[test]
    fn an_invalid_row_is_rejected_with_its_line() {
        let mut text = vec![];
        write(&[row()], &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        let error = read(text.replace(",success,", ",triumph,").as_bytes()).unwrap_err().to_string();
        assert!(error.contains("line: 2") && error.contains("triumph"), "{error}");
        let error = read(text.replacen("ttc_s", "ttc", 1).as_bytes()).unwrap_err().to_string();
        assert!(error.contains("unknown field `ttc`"), "{error}");
    }
}
