//! The command line.

use crate::command::{
    alarm, answer, audit, backup, cancel, cert, check, close, completions, doctor, domain, driver, dry_run, explain,
    fleet, history, hold, keys, lab, leave, limit, maintenance, map, missions, priority, reassign, record, recover,
    replay, requests, resolve, restore, robot, schedule, schema, station, submit, token, upgrade, watch, world,
};
use crate::demo;
use crate::domains;
use crate::exit::Failure;
use crate::output;
use clap::{CommandFactory, Parser, Subcommand};
use consort_skills::extensions::Extensions;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

/// Mission coordination for fleets of heterogeneous robots, without a single point of failure.
///
/// Nodes of a fleet (robots, stations, a simulated world) find each other over Zenoh and elect a
/// coordinator. Missions are submitted to the coordinator. Robots estimate the cost of their own
/// work, and the best coalition gets the mission. The fleet carries on when any node fails.
#[derive(Debug, Parser)]
#[command(name = "consort", version, max_term_width = 100, after_long_help = AFTER_HELP)]
pub struct Cli {
    /// A domain file: actions and task types in addition to the standard ones; may be repeated. All
    /// nodes of a fleet need the same files
    #[arg(long = "domain", global = true, value_name = "FILE", env = "CONSORT_DOMAIN", value_delimiter = ',')]
    domains: Vec<PathBuf>,
    /// The command.
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Examples:
  # the main use case, from beginning to end
  consort demo

  # the result of an auction, without a fleet
  consort dry-run lab-samples --workers examples/workers.toml

  # a fleet on a single machine, each node in its own terminal
  consort world   --config examples/world.toml
  consort station --config examples/station.toml
  consort robot   --config examples/robot.toml
  consort robot   --config examples/arm.toml
  consort submit lab-samples --set room='IC Room 6' --wait

  # the same from another machine
  consort missions --connect tcp/192.0.2.7:7447 --watch

A flag with [env: …] can be set by that environment variable instead. Flags override variables, variables override
files, and files override defaults.

Exit codes: 0 success; 1 the operation failed (a mission failed, a check found problems); 2 the flags or files are
wrong; 3 no node was reached, or there is no coordinator.";

// Each command is described at its flags.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Robot(robot::Args),
    Station(station::Args),
    World(world::Args),
    Submit(submit::Args),
    Missions(missions::Args),
    Explain(explain::Args),
    Cancel(cancel::Args),
    Priority(priority::Args),
    Reassign(reassign::Args),
    Resolve(resolve::Args),
    Schedule(schedule::Args),
    Hold(hold::HoldArgs),
    Release(hold::ReleaseArgs),
    Maintenance(maintenance::Args),
    Close(close::CloseArgs),
    Open(close::OpenArgs),
    Limit(limit::Args),
    Alarm(alarm::Args),
    Audit(audit::Args),
    History(history::Args),
    Requests(requests::Args),
    Answer(answer::Args),
    Fleet(fleet::Args),
    Keys(keys::Args),
    Leave(leave::Args),
    Check(check::Args),
    Schema(schema::Args),
    Doctor(doctor::Args),
    Driver(driver::Args),
    Map(map::Args),
    Domain(domain::Args),
    DryRun(dry_run::Args),
    Backup(backup::Args),
    Restore(restore::Args),
    Upgrade(upgrade::Args),
    Recover(recover::Args),
    Cert(cert::Args),
    Token(token::Args),
    Lab(lab::Args),
    Watch(watch::Args),
    Completions(completions::Args),
    Man(completions::ManArgs),
    Record(record::Args),
    Replay(replay::Args),
}

/// Runs the program.
pub fn run() -> ExitCode {
    run_with(Extensions::default(), std::env::args_os())
}

/// Runs a program with additional skills. The first of `args` is the program's name.
pub fn run_with(extensions: Extensions, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = Cli::parse_from(args);
    let extensions = match domains::with_files(extensions, &cli.domains) {
        Ok(extensions) => extensions,
        Err(problems) => return output::exit_code("consort", Err(Failure::from(problems))),
    };
    output::exit_code(
        "consort",
        match cli.command {
            Command::Demo(args) => demo::run(args, extensions),
            Command::Robot(args) => robot::run(args, extensions),
            Command::Station(args) => station::run(args, extensions),
            Command::World(args) => world::run(args, extensions),
            Command::Submit(args) => submit::run(args),
            Command::Missions(args) => missions::run(args),
            Command::Explain(args) => explain::run(args),
            Command::Cancel(args) => cancel::run(args),
            Command::Priority(args) => priority::run(args),
            Command::Reassign(args) => reassign::run(args),
            Command::Resolve(args) => resolve::run(args),
            Command::Schedule(args) => schedule::run(args),
            Command::Hold(args) => hold::run(args),
            Command::Release(args) => hold::release(args),
            Command::Maintenance(args) => maintenance::run(args),
            Command::Close(args) => close::run(args),
            Command::Open(args) => close::open(args),
            Command::Limit(args) => limit::run(args),
            Command::Alarm(args) => alarm::run(args),
            Command::Audit(args) => audit::run(args),
            Command::History(args) => history::run(args),
            Command::Requests(args) => requests::run(args),
            Command::Answer(args) => answer::run(args),
            Command::Fleet(args) => fleet::run(args),
            Command::Keys(args) => keys::run(args),
            Command::Leave(args) => leave::run(args),
            Command::Check(args) => check::run(args, extensions),
            Command::Schema(args) => schema::run(&args),
            Command::Doctor(args) => doctor::run(args, extensions),
            Command::Driver(args) => driver::run(args, extensions),
            Command::Map(args) => map::run(args),
            Command::Domain(args) => domain::run(args, extensions),
            Command::DryRun(args) => dry_run::run(args, extensions),
            Command::Backup(args) => backup::run(args),
            Command::Restore(args) => restore::run(args),
            Command::Upgrade(args) => upgrade::run(args),
            Command::Recover(args) => recover::run(args),
            Command::Cert(args) => cert::run(args),
            Command::Token(args) => token::run(args),
            Command::Lab(args) => lab::run(&args),
            Command::Watch(args) => watch::run(args),
            Command::Completions(args) => completions::run(&args, Cli::command()),
            Command::Man(args) => completions::man(&args, Cli::command()),
            Command::Record(args) => record::run(args),
            Command::Replay(args) => replay::run(args),
        },
    )
}
