//! Distributions of durations and results in the simulator.

use super::*;

const BAKERY: &str = r#"
domain: bakery
actions:
  bake:
    results: { heat: { type: integer, minimum: 0, maximum: 90 }, mass_kg: { type: number, minimum: 0, maximum: 2 } }
    simulate:
      duration_s: { normal: { mean: 8, deviation: 2, minimum: 4, maximum: 15 } }
      results:
        heat: { exponential: { mean: 20, maximum: 90 } }
        mass_kg: { normal: { mean: 1, deviation: 0.1, minimum: 0.5, maximum: 1.5 } }
tasks:
  bake: { action: bake }
"#;

#[test]
fn durations_and_results_have_distributions() {
    let domain = check(BAKERY).unwrap();
    let (_, action) = domain.simulated_actions().next().unwrap();
    let normal = Distribution::Normal(Normal { mean: 8.0, deviation: 2.0, minimum: 4.0, maximum: 15.0 });
    assert_eq!(action.simulate.duration_s, SimulatedDuration::Distributed(normal));
    assert_eq!(action.simulate.mean_s(), 8.0);
    let exponential = Distribution::Exponential(Exponential { mean: 20.0, maximum: 90.0 });
    assert_eq!(action.simulate.results["heat"], SimulatedResult::Distributed(exponential));
    let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
    assert_eq!(estimator.estimate(&task("bake", &[]), &robot()).unwrap().time.get(), 8.0);
}

#[test]
fn wrong_distributions_are_reported_with_what_is_allowed() {
    let (duration, heat) = ("actions.bake.simulate.duration_s: ", "actions.bake.simulate.results.heat: ");
    let normal = "allowed are a `mean` from `minimum` to `maximum`, and a `deviation` of 0 or more";
    let exponential = "allowed are a `mean` above 0, and a `maximum` that is not less than the `mean`";
    let bounds = "distribution from 0 to 99 does not fit the result; allowed is a whole number from 0 to 90";
    for (part, changed, expected) in [
        ("maximum: 15", "maximum: 7", format!("{duration}{normal}")),
        ("deviation: 2", "deviation: -2", format!("{duration}{normal}")),
        ("minimum: 4", "minimum: -4", format!("{duration}allowed is a `minimum` of 0 s or more")),
        ("mean: 20, maximum: 90", "mean: 0, maximum: 90", format!("{heat}{exponential}")),
        ("mean: 20, maximum: 90", "mean: 100, maximum: 90", format!("{heat}{exponential}")),
        ("mean: 20, maximum: 90", "mean: 20, maximum: 99", format!("{heat}the exponential {bounds}")),
    ] {
        let problems = check(&BAKERY.replacen(part, changed, 1)).unwrap_err();
        assert_eq!(problems, [expected], "{changed}");
    }
    let feedback = "domain: d\nactions: { bake: { feedback: { heat: { type: number } }, \
                    simulate: { feedback: { heat: { exponential: { mean: 1, maximum: 2 } } } } } }";
    let expected = "actions.bake.simulate.feedback.heat: the exponential distribution from 0 to 2 cannot be passed through; \
                    allowed are a range, a list and a value";
    assert_eq!(check(feedback).unwrap_err(), [expected]);
}

#[test]
fn an_unknown_distribution_is_rejected_with_the_known_ones() {
    let allowed = "{ normal: { mean, deviation, minimum, maximum } } and { exponential: { mean, maximum } }";
    for (part, changed, first) in [
        ("normal: { mean: 8, deviation", "normal: { mean: 8, sd", "allowed are [least, greatest], "),
        ("normal: { mean: 8", "gaussian: { mean: 8", "allowed are [least, greatest], "),
        ("exponential", "poisson", "allowed are [least, greatest], a list of values, a value, "),
    ] {
        let problem = yaml::parse::<DomainForm>(&BAKERY.replacen(part, changed, 1)).unwrap_err();
        assert!(problem.contains(&format!("{first}{allowed}")), "{problem}");
    }
}
