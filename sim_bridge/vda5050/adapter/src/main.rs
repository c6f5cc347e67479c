//! `consort-vda5050`: vehicles of VDA 5050 as robots of a fleet.

use clap::{Parser, Subcommand, ValueEnum};
use consort_vda5050::file::VehicleSettings;
use consort_vda5050::vehicles::{self, VehiclesSettings};
use consort_vda5050::{check, driver};
use consort_vda5050_core::{Topic, Version, schema};
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use std::{fmt, io};
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// Vehicles of VDA 5050 (2.0, 2.1, 3.0) as robots of a fleet
#[derive(Debug, Parser)]
#[command(
    version,
    after_long_help = "\
A robot of a fleet is a node with a driver. For a vehicle of VDA 5050 the driver is this program: it speaks
JSON lines to the node, and MQTT to the vehicle. One process drives one vehicle.

  1. Describe the vehicle in a file: broker, manufacturer, serial number, places and actions.
  2. Check the file, then the vehicle:   consort-vda5050 check vehicle.yaml --connect 5
  3. Name the driver in the robot file:  driver = [\"consort-vda5050\", \"driver\", \"vehicle.yaml\"]
  4. Start the robot:                    consort robot --config robot.toml

The smallest file:

  broker: { url: \"mqtt://127.0.0.1:1883\" }
  version: \"2.0\"
  manufacturer: ACME
  serial: \"7\"
  map: ward
  places:
    Dock: { node: n1, x_m: 0, y_m: 0 }
    Ward: { node: n2, x_m: 5, y_m: 0 }
  actions:
    pick_load: { type: pick, blocking: HARD, parameters: { loadId: \"{load}\" } }
    dock: { type: startCharging, scope: instant, blocking: HARD }

The tutorial docs/tutorials/vda5050.md explains every key."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Log filter: error, warn, info, debug or trace, also by module
    #[arg(long, env = "RUST_LOG", global = true, value_name = "FILTER", default_value = "info")]
    log: String,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Drive the vehicle of a file: the driver of a robot, on the standard streams
    Driver {
        /// File of the vehicle, in YAML
        file: PathBuf,
    },
    /// Check the file of a vehicle, and print what it describes
    Check {
        /// File of the vehicle, in YAML
        file: PathBuf,
        /// Also connect, and request state and factsheet of the vehicle; it does not move
        #[arg(long, value_name = "SECONDS")]
        connect: Option<u64>,
    },
    /// Simulate the vehicles of a file for a foreign fleet control
    Vehicles {
        /// File of the vehicles, in YAML
        file: PathBuf,
    },
    /// Print the JSON Schema by which messages are checked
    Schema {
        /// Topic
        topic: TopicArg,
        /// Version of the protocol
        #[arg(long, default_value = "2.1")]
        vda: Version,
    },
}

#[derive(Debug, Clone, Copy, ValueEnum)]
#[value(rename_all = "camelCase")]
enum TopicArg {
    Order,
    InstantActions,
    State,
    Visualization,
    Connection,
    Factsheet,
}

impl From<TopicArg> for Topic {
    fn from(topic: TopicArg) -> Topic {
        match topic {
            TopicArg::Order => Topic::Order,
            TopicArg::InstantActions => Topic::InstantActions,
            TopicArg::State => Topic::State,
            TopicArg::Visualization => Topic::Visualization,
            TopicArg::Connection => Topic::Connection,
            TopicArg::Factsheet => Topic::Factsheet,
        }
    }
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let filter = EnvFilter::try_new(&cli.log).unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr).init();
    let runtime = match tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build() {
        Ok(runtime) => runtime,
        Err(problem) => return fail(problem),
    };
    let code = runtime.block_on(run(cli.command));
    // The reader of the standard input may wait for ever.
    runtime.shutdown_background();
    code
}

async fn run(command: Command) -> ExitCode {
    match command {
        Command::Driver { file } => match VehicleSettings::read(&file) {
            Ok(settings) => driver::run(settings).await,
            Err(problem) => return fail(problem),
        },
        Command::Check { file, connect } => {
            let settings = match VehicleSettings::read(&file) {
                Ok(settings) => settings,
                Err(problem) => return fail(problem),
            };
            print(&check::describe(&settings));
            if let Some(seconds) = connect {
                let report = check::ask(&settings, Duration::from_secs(seconds)).await;
                print(&report.lines(&settings));
                if report.state.is_none() {
                    return ExitCode::FAILURE;
                }
            }
        }
        Command::Vehicles { file } => match VehiclesSettings::read(&file) {
            Ok(settings) => vehicles::run(settings, stopped()).await,
            Err(problem) => return fail(problem),
        },
        Command::Schema { topic, vda } => {
            let schema = schema::schema(topic.into(), vda);
            print(&[serde_json::to_string_pretty(&schema).unwrap_or_default()]);
        }
    }
    ExitCode::SUCCESS
}

/// Waits for SIGTERM or the interrupt of the terminal.
async fn stopped() {
    let interrupted = async { drop(tokio::signal::ctrl_c().await) };
    match signal(SignalKind::terminate()) {
        Ok(mut terminated) => {
            tokio::select! {
                () = interrupted => {}
                _ = terminated.recv() => {}
            }
        }
        Err(_) => interrupted.await,
    }
}

fn print(lines: &[String]) {
    let mut output = io::stdout().lock();
    for line in lines {
        // A reader that has gone reads nothing.
        let _ = writeln!(output, "{line}");
    }
}

fn fail(problem: impl fmt::Display) -> ExitCode {
    let _ = writeln!(io::stderr(), "error: {problem}");
    ExitCode::FAILURE
}
