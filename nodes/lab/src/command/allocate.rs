//! `consort-lab allocate`: allocates the jobs of instances of the literature by auctions on the virtual bus.

use clap::Args as ClapArgs;
use consort_evaluation::allocation::{
    AllocationPolicy, CheckedRoutes, Instance, check_routes, read_instance, usual_orders,
};
use consort_nodes::command::flag_values::InvalidValue;
use consort_nodes::diagnostic::{Diagnostic, Diagnostics};
use consort_nodes::exit::Failure;
use consort_nodes::inputs::read_text;
use consort_nodes::output::{self, Progress};
use consort_tests::allocation::{AllocationRun, allocate_on_bus};
use consort_text::count;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Allocates jobs with time windows to robots by auctions, and prints the routes
///
/// An instance contains jobs with positions, time windows, durations and demands, and the depot where all robots begin
/// and end. Each robot is a node on the virtual bus with a timeline of its own. It prices jobs by the additional distance
/// of the best position in its timeline. The auctioneer sees prices only.
///
/// Policies: `consort` awards all jobs, and then releases groups of neighbouring jobs and awards them again as long as
/// that pays. `tessi` awards the least price of all jobs and robots in each round (TeSSI, with the distance as its
/// objective). `greedy` awards the jobs in the order of their earliest begin, each appended to the robot that begins it
/// first. A job that no robot can do in time stays unassigned.
///
/// Distances and travel times are Euclidean and truncated to one decimal place, as for the best known results of exact
/// methods.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab allocate C101.txt                                  # robots and capacity from Solomon's file
  consort-lab allocate R105.25.csv --robots 6 --capacity 200     # CSV: customer,x,y,demand,ready,due,service
  consort-lab allocate *.csv --robots 25 --policy tessi --json   # an object for each file

With --json: instance, policy, robots, distance, late, unassigned, messages, wall_ms, routes (numbers of customers).

The same file, policy and seed give the same routes and messages on any machine; wall_ms depends on the machine.

Exit codes: 0 all files were allocated, even if jobs are unassigned; 2 the flags or the files are wrong.")]
pub(crate) struct Args {
    /// Instances: Solomon's text format, or CSV
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Number of robots [default: that of the file; a CSV file has none]
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=1000))]
    robots: Option<usize>,
    /// Rule of the allocation: consort, tessi, greedy
    #[arg(long, default_value = "consort", value_parser = policy)]
    policy: AllocationPolicy,
    /// Capacity of each robot [default: that of the file; for CSV unlimited]
    #[arg(long, value_name = "N", value_parser = capacity)]
    capacity: Option<f64>,
    /// Maximum number of orders to robots, of the policy `consort` [default: 60000 for 25 jobs, 45000 for 50, 25000 for 100]
    #[arg(long, value_name = "N")]
    orders: Option<usize>,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print a JSON object for each file
    #[arg(long)]
    json: bool,
}

fn policy(text: &str) -> Result<AllocationPolicy, InvalidValue> {
    text.parse().map_err(InvalidValue::new)
}

fn capacity(text: &str) -> Result<f64, InvalidValue> {
    let capacity = text.parse::<f64>().ok().filter(|capacity| capacity.is_finite() && *capacity >= 0.0);
    capacity.ok_or_else(|| InvalidValue::new(format_args!("{text:?} is not a number, 0 or more")))
}

/// Result of a file.
#[derive(Serialize)]
struct AllocatedFile {
    instance: String,
    policy: &'static str,
    robots: usize,
    distance: f64,
    late: usize,
    unassigned: usize,
    messages: u64,
    wall_ms: f64,
    /// Customers of each robot that has any, in their order.
    routes: Vec<Vec<usize>>,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong files; nothing is allocated then.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut problems = vec![];
    let mut instances = vec![];
    for file in &args.files {
        match read(file, args) {
            Ok(instance) => instances.push(instance),
            Err(Diagnostics(of_file)) => problems.extend(of_file),
        }
    }
    Diagnostics::into_result(problems)?;
    let mut waiting = Progress::on_terminal();
    for instance in instances {
        waiting.show(format_args!("{}: {}", instance.name, count(instance.jobs.len(), "job", "jobs")));
        let began = Instant::now();
        let orders = args.orders.unwrap_or_else(|| usual_orders(instance.jobs.len()));
        let AllocationRun { routes, messages } = allocate_on_bus(&instance, args.policy, orders, args.seed);
        let wall_ms = began.elapsed().as_secs_f64() * 1000.0;
        let checked = check_routes(&instance, &routes)
            .map_err(|problem| Failure::Unsuccessful(format!("{}: {problem}", instance.name)))?;
        waiting.clear();
        let CheckedRoutes { distance, late, unassigned } = checked;
        let customers = |route: Vec<usize>| route.into_iter().map(|job| job + 1).collect::<Vec<_>>();
        let allocated = AllocatedFile {
            instance: instance.name.clone(),
            policy: args.policy.name(),
            robots: instance.robots,
            distance,
            late,
            unassigned,
            messages,
            wall_ms: (wall_ms * 10.0).round() / 10.0,
            routes: routes.into_iter().filter(|route| !route.is_empty()).map(customers).collect(),
        };
        if args.json { output::json(&allocated)? } else { print(&instance, &allocated)? }
    }
    Ok(())
}

fn read(file: &Path, args: &Args) -> Result<Instance, Diagnostics> {
    let text = read_text(file)?;
    read_instance(&text, file, args.robots, args.capacity)
        .map_err(|problem| Diagnostic::for_file(file.display(), problem).into())
}

fn print(instance: &Instance, allocated: &AllocatedFile) -> Result<(), Failure> {
    let (jobs, robots) = (count(instance.jobs.len(), "job", "jobs"), count(instance.robots, "robot", "robots"));
    output::line(format_args!("{}: {jobs}, {robots}, {}", allocated.instance, allocated.policy))?;
    for (number, route) in (1..).zip(&allocated.routes) {
        let customers: Vec<String> = route.iter().map(usize::to_string).collect();
        output::line(format_args!("  robot {number}: {}", customers.join(" ")))?;
    }
    output::line(format_args!(
        "  distance {:.1}, {} late, {} unassigned, {} messages, {:.0} ms",
        allocated.distance, allocated.late, allocated.unassigned, allocated.messages, allocated.wall_ms
    ))
}
