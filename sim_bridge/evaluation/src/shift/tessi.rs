//! The rule of TeSSI (Nunes and Gini, 2015) for a request.

use consort_protocol::timeline::{Insertion, Job, Timeline, Travel};

/// Returns the timeline that ends first with the job, the first of equal ones, and the position of the job in it: the
/// position with which it ends first, the last of those that are equal to a millisecond. `None` if the job fits
/// nowhere. For timelines without time windows: an insertion then delays all jobs behind it by the same time.
pub fn tessi_insertion<K: PartialEq, P>(
    timelines: &[Timeline<K, P>],
    job: &Job<K, P>,
    travel: &impl Travel<P>,
) -> Option<(usize, usize)> {
    let offers = timelines.iter().enumerate().filter_map(|(robot, timeline)| {
        let end_s = |found: &Insertion| match found.position == timeline.jobs().len() {
            true => found.begin_s + job.duration_s,
            false => timeline.free_from_s() + found.delay_s,
        };
        let found = timeline.cheapest_insertion(job, travel, |found| ((end_s(found) * 1e3).round(), found.delay_s))?;
        Some((end_s(&found), robot, found.position))
    });
    offers.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, robot, position)| (robot, position))
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Line;

    impl Travel<f64> for Line {
        fn seconds(&self, from: &f64, to: &f64) -> f64 {
            (to - from).abs()
        }
    }

    fn job(key: u8, place: f64) -> Job<u8, f64> {
        Job { duration_s: 5.0, ..Job::at(key, place) }
    }

    #[test]
    fn a_job_goes_where_the_timeline_ends_first() {
        let busy = |jobs: &[Job<u8, f64>]| Timeline::new(0.0, 0.0).with_jobs(jobs.to_vec(), &Line);
        // The way to 30 leads past 10: the timeline ends at 40 with the job before, and at 60 with the job behind.
        let far = busy(&[job(1, 30.0)]);
        assert_eq!(tessi_insertion(std::slice::from_ref(&far), &job(2, 10.0), &Line), Some((0, 0)));
        // Another robot would end at 45, or at 35.
        assert_eq!(tessi_insertion(&[far.clone(), Timeline::new(50.0, 0.0)], &job(2, 10.0), &Line), Some((0, 0)));
        assert_eq!(tessi_insertion(&[far, Timeline::new(40.0, 0.0)], &job(2, 10.0), &Line), Some((1, 0)));
        // Of jobs at the same place, the earlier stays first.
        assert_eq!(tessi_insertion(&[busy(&[job(1, 30.0)])], &job(2, 30.0), &Line), Some((0, 1)));
        assert_eq!(tessi_insertion::<u8, f64>(&[], &job(2, 10.0), &Line), None);
    }
}
