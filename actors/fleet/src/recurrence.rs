//! Times of schedules: patterns in the format of cron, in a time zone.
//!
//! Times of day that a change to summer time leaves out count at the moment of the change, and times that the change
//! back repeats count once. Patterns with `*` or steps for the minute or the hour, such as `*/10 * * * *`, follow the clock in both cases.

use consort_protocol::ledger::{MissedOccurrences, ScheduleEntry, ScheduleRule};
use consort_protocol::view::ScheduleView;
use croner::Cron;
use croner::parser::{CronParser, Seconds, Year};
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};

/// An occurrence that could not be submitted within this time has been missed. Raised: occurrences during a short
/// outage are submitted late instead of being left out.
const LATE_MS: u64 = 60_000;

/// Error: the times of a schedule are invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecurrenceError {
    /// The pattern is invalid.
    #[error(
        "cron is {pattern:?}: {problem}; allowed are five fields: minute, hour, day of the month, month and day of the week, such as `0 8 * * 1-5`"
    )]
    Pattern {
        /// The pattern.
        pattern: String,
        /// The problem.
        problem: String,
    },
    /// The time zone is unknown.
    #[error("zone is {zone:?}; allowed are UTC and the names of the IANA database, such as Europe/Berlin")]
    Zone {
        /// The name.
        zone: String,
    },
}

/// Times of a schedule.
#[derive(Debug, Clone)]
pub struct Recurrence {
    cron: Cron,
    zone: TimeZone,
    until_ms: Option<u64>,
}

/// What is due for a schedule. Times are in milliseconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DueOccurrence {
    /// The occurrence of this time is submitted.
    Submit(u64),
    /// The occurrences up to this time are left out.
    SkipUntil(u64),
}

impl Recurrence {
    /// Parses the times of a schedule.
    ///
    /// # Errors
    /// [`RecurrenceError`] if the pattern or the time zone is invalid.
    pub fn parse(rule: &ScheduleRule) -> Result<Recurrence, RecurrenceError> {
        let parser = CronParser::builder().seconds(Seconds::Disallowed).year(Year::Disallowed).build();
        let cron = parser.parse(&rule.cron).map_err(|problem| RecurrenceError::Pattern {
            pattern: rule.cron.clone(),
            problem: problem.to_string().trim_end_matches('.').to_owned(),
        })?;
        let zone = TimeZone::get(&rule.zone).map_err(|_| RecurrenceError::Zone { zone: rule.zone.clone() })?;
        Ok(Recurrence { cron, zone, until_ms: rule.until_ms })
    }

    /// Returns the time of the first occurrence after a time, in milliseconds since 1970; `None` if there is none.
    pub fn next_after(&self, after_ms: u64) -> Option<u64> {
        let next = milliseconds(&self.cron.find_next_occurrence(&self.zoned(after_ms)?, false).ok()?)?;
        Some(next).filter(|next| self.until_ms.is_none_or(|until| *next <= until))
    }

    /// Returns the time of the last occurrence up to a time.
    fn last_until(&self, until_ms: u64) -> Option<u64> {
        let until_ms = self.until_ms.map_or(until_ms, |end| end.min(until_ms));
        milliseconds(&self.cron.find_previous_occurrence(&self.zoned(until_ms)?, true).ok()?)
    }

    /// Returns what is due at `now_ms` for a schedule whose occurrences up to `handled_ms` are handled.
    pub fn due(&self, missed: MissedOccurrences, handled_ms: u64, now_ms: u64) -> Option<DueOccurrence> {
        let next = self.next_after(handled_ms).filter(|next| *next <= now_ms)?;
        let is_late = |due_ms: u64| now_ms - due_ms > LATE_MS;
        Some(match missed {
            _ if !is_late(next) => DueOccurrence::Submit(next),
            MissedOccurrences::All => DueOccurrence::Submit(next),
            MissedOccurrences::Last => DueOccurrence::Submit(self.last_until(now_ms).unwrap_or(next)),
            MissedOccurrences::Skip => DueOccurrence::SkipUntil(now_ms - LATE_MS - 1),
        })
    }

    fn zoned(&self, time_ms: u64) -> Option<Zoned> {
        let timestamp = Timestamp::from_millisecond(i64::try_from(time_ms).ok()?).ok()?;
        Some(timestamp.to_zoned(self.zone.clone()))
    }
}

/// Returns the view of a schedule.
pub(crate) fn schedule_view(entry: &ScheduleEntry) -> ScheduleView {
    let next = Recurrence::parse(&entry.schedule.rule).ok().and_then(|times| times.next_after(entry.handled_ms));
    ScheduleView::of(entry, next)
}

/// Formats a time in milliseconds since 1970 in a time zone: `2026-11-27 08:00 CET`. In UTC if the zone is unknown.
pub fn time_in_zone(time_ms: u64, zone: &str) -> String {
    let time = i64::try_from(time_ms).ok().and_then(|time_ms| Timestamp::from_millisecond(time_ms).ok());
    let zone = TimeZone::get(zone).unwrap_or(TimeZone::UTC);
    time.map_or_else(
        || format!("{time_ms} ms after 1970"),
        |time| time.to_zoned(zone).strftime("%F %H:%M %Z").to_string(),
    )
}

/// Formats the end of an order of people after its text: `, until 2026-11-27 08:00 UTC`. Empty without an end.
pub fn until_text(until_ms: Option<u64>) -> String {
    until_ms.map(|until_ms| format!(", until {}", time_in_zone(until_ms, "UTC"))).unwrap_or_default()
}

fn milliseconds(time: &Zoned) -> Option<u64> {
    u64::try_from(time.timestamp().as_millisecond()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recurrence(cron: &str, zone: &str) -> Recurrence {
        let (cron, zone) = (cron.to_owned(), zone.to_owned());
        let rule = ScheduleRule { cron, zone, until_ms: None, missed: MissedOccurrences::Skip };
        Recurrence::parse(&rule).unwrap()
    }

    fn ms(time: &str) -> u64 {
        u64::try_from(time.parse::<Timestamp>().unwrap().as_millisecond()).unwrap()
    }

    /// Returns the first occurrences after a time, in UTC.
    fn occurrences(recurrence: &Recurrence, after: &str, count: usize) -> Vec<String> {
        let next = |after: &u64| recurrence.next_after(*after);
        let times = std::iter::successors(recurrence.next_after(ms(after)), next).take(count);
        times.map(|time| Timestamp::from_millisecond(time as i64).unwrap().to_string()).collect()
    }

    #[test]
    fn times_are_those_of_the_time_zone() {
        let weekdays = recurrence("0 8 * * 1-5", "Europe/Berlin");
        let expected = ["2026-11-27T07:00:00Z", "2026-11-30T07:00:00Z", "2026-12-01T07:00:00Z"];
        assert_eq!(occurrences(&weekdays, "2026-11-26T07:00:00Z", 3), expected);
        assert_eq!(
            occurrences(&recurrence("0 8 * * *", "UTC"), "2026-11-26T07:59:59.999Z", 1),
            ["2026-11-26T08:00:00Z"]
        );
    }

    #[test]
    fn a_time_that_summer_time_leaves_out_counts_at_the_change() {
        // On 2027-03-28 the clocks go from 02:00 to 03:00.
        let nightly = recurrence("30 2 * * *", "Europe/Berlin");
        let expected = ["2027-03-27T01:30:00Z", "2027-03-28T01:00:00Z", "2027-03-29T00:30:00Z"];
        assert_eq!(occurrences(&nightly, "2027-03-26T12:00:00Z", 3), expected);
    }

    #[test]
    fn a_time_that_the_change_back_repeats_counts_once() {
        // On 2026-10-25 the clocks go from 03:00 back to 02:00.
        let nightly = recurrence("30 2 * * *", "Europe/Berlin");
        let expected = ["2026-10-24T00:30:00Z", "2026-10-25T00:30:00Z", "2026-10-26T01:30:00Z"];
        assert_eq!(occurrences(&nightly, "2026-10-23T12:00:00Z", 3), expected);
        let hourly = recurrence("30 * * * *", "Europe/Berlin");
        let expected = ["2026-10-25T00:30:00Z", "2026-10-25T01:30:00Z", "2026-10-25T02:30:00Z"];
        assert_eq!(occurrences(&hourly, "2026-10-25T00:00:00Z", 3), expected, "every hour that passes");
    }

    #[test]
    fn a_schedule_ends() {
        let until_ms = Some(ms("2026-11-27T08:00:00Z"));
        let ending = Recurrence { until_ms, ..recurrence("0 8 * * *", "UTC") };
        assert_eq!(occurrences(&ending, "2026-11-25T12:00:00Z", 9), ["2026-11-26T08:00:00Z", "2026-11-27T08:00:00Z"]);
        assert_eq!(recurrence("0 0 30 2 *", "UTC").next_after(0), None, "never");
    }

    #[test]
    fn missed_occurrences_are_left_out_or_submitted_late() {
        use MissedOccurrences::{All, Last, Skip};
        let daily = recurrence("0 8 * * *", "UTC");
        let (handled, first) = (ms("2026-11-20T08:00:00Z"), ms("2026-11-21T08:00:00Z"));
        for missed in [Skip, Last, All] {
            assert_eq!(daily.due(missed, handled, first - 1), None);
            assert_eq!(daily.due(missed, handled, first), Some(DueOccurrence::Submit(first)));
            assert_eq!(daily.due(missed, handled, first + LATE_MS), Some(DueOccurrence::Submit(first)));
        }
        let after_outage = ms("2026-11-24T09:00:00Z");
        assert_eq!(daily.due(All, handled, after_outage), Some(DueOccurrence::Submit(first)));
        let last = ms("2026-11-24T08:00:00Z");
        assert_eq!(daily.due(Last, handled, after_outage), Some(DueOccurrence::Submit(last)));
        assert_eq!(daily.due(Last, last, after_outage), None);
        let Some(DueOccurrence::SkipUntil(until)) = daily.due(Skip, handled, after_outage) else { panic!() };
        assert_eq!(daily.due(Skip, until, after_outage), None);
        assert_eq!(daily.next_after(until), Some(ms("2026-11-25T08:00:00Z")));
        // The latest occurrence is in time, so it is submitted after the missed ones are left out.
        let in_time = last + LATE_MS;
        let Some(DueOccurrence::SkipUntil(until)) = daily.due(Skip, handled, in_time) else { panic!() };
        assert_eq!(daily.due(Skip, until, in_time), Some(DueOccurrence::Submit(last)));
    }

    #[test]
    fn invalid_rules_are_rejected() {
        for (cron, zone, expected) in [
            ("0 8 * *", "UTC", "cron is \"0 8 * *\": "),
            ("0 0 8 * * *", "UTC", "allowed are five fields"),
            ("61 8 * * *", "UTC", "cron is \"61 8 * * *\""),
            ("0 8 * * *", "Europe/Atlantis", "zone is \"Europe/Atlantis\"; allowed are UTC and"),
        ] {
            let (cron, zone) = (cron.to_owned(), zone.to_owned());
            let rule = ScheduleRule { cron, zone, until_ms: None, missed: MissedOccurrences::Skip };
            let error = Recurrence::parse(&rule).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
