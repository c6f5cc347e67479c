//! `consort cert`: manages the certificates of a fleet.

use crate::certs::{CertificateEntry, CertificateState, CertificateStore};
use crate::exit::Failure;
use crate::output;
use consort_protocol::ids::{FleetId, NodeId, PersonId};
use consort_protocol::trust::{AccessScope, Identity, MissionRights, NodeRole, Principal, ServedName};
use consort_text::count;
use std::path::{Path, PathBuf};

/// Make, renew and revoke the certificates of a fleet
///
/// A fleet with certificates is closed. Links are encrypted (TLS 1.3), and both ends prove their
/// identity. Every message between nodes carries the signature of its sender, so that a relay
/// cannot forge it. Each node has a folder with its files, and is started with `--certs FOLDER`.
/// Each person has a folder too, with permission to read, submit or operate.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The folder of the fleet's certificates. Its folder `authority` signs for the fleet: keep it
    /// on a single machine, and keep a copy safe
    #[arg(long, env = "CONSORT_CERTS_DIR", value_name = "DIR", default_value = "certs", global = true)]
    dir: PathBuf,
    #[command(subcommand)]
    what: CertCommand,
}

const EXAMPLES: &str = "\
Examples:
  consort cert init --fleet ward
  consort cert node ada --roles robot,voter
  consort cert node ward-1 --roles voter --address 192.0.2.7
  consort cert node world --roles host,voter --serves ada,lab-arm,nurse
  consort cert person kim --scope submit
  consort cert person lee --scope submit --missions lab-samples,vital-signs
  consort cert show

  # certs/ada is copied to ada's machine, certs/kim to Kim's
  consort robot --config ada.toml --certs certs/ada --listen tls/0.0.0.0:7447
  consort missions --certs certs/kim --connect tls/192.0.2.7:7447

  # before a certificate expires, and when a machine is lost
  consort cert renew ada
  consort cert revoke ada";

#[derive(Debug, clap::Subcommand)]
enum CertCommand {
    /// Create the authority of a fleet
    Init {
        /// The fleet's name
        #[arg(long, value_name = "NAME")]
        fleet: FleetId,
        /// Validity in days: all certificates of the authority end with it
        #[arg(long, value_name = "DAYS", default_value_t = 3650, value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: u32,
    },
    /// Make a node's certificate
    Node {
        /// The node's name: a robot's node has the name of the robot
        name: NodeId,
        /// Permitted roles: robot, voter (keeps the ledger, may coordinate), host (of a world, of
        /// robot drivers, of people), dashboard (forwards the requests of its visitors)
        #[arg(long, value_name = "ROLES", value_delimiter = ',', required = true)]
        roles: Vec<NodeRole>,
        /// Robots, and roles of people, that a host serves: names, `drone-*` for all that begin so, or
        /// `*` for all. Nodes reject states of other robots by it
        #[arg(long, value_name = "NAMES", value_delimiter = ',')]
        serves: Vec<ServedName>,
        /// Name or address of the node, for clients that verify it; may be repeated
        #[arg(long, value_name = "HOST")]
        address: Vec<String>,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Make the certificate of a person, or of a program for which a person is responsible
    Person {
        /// The name
        name: PersonId,
        /// Permission: read; submit (and cancel) missions; operate (resolve missions, decommission
        /// nodes). Each includes the former
        #[arg(long, value_name = "SCOPE", default_value = "read")]
        scope: AccessScope,
        /// Missions that the person may submit or schedule: names of shipped missions and of missions of the fleet file,
        /// or `*` for all missions and mission files
        #[arg(long, value_name = "NAMES", default_value = "*")]
        missions: MissionRights,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Make a new certificate and key for an existing name
    Renew {
        /// The name
        name: String,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Revoke a certificate
    ///
    /// Within seconds after the new list is in its folder, a node rejects everything signed with the
    /// certificate, closes its links with the principal, and accepts no new ones.
    Revoke {
        /// The name
        name: String,
    },
    /// List the certificates and their validity
    Show {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
struct ValidityFlag {
    /// Validity in days
    #[arg(long, value_name = "DAYS", default_value_t = 90, value_parser = clap::value_parser!(u32).range(1..=36_500))]
    days: u32,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for a problem with the folder or a name; nothing was changed.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let dir = args.dir;
    match args.what {
        CertCommand::Init { fleet, days } => {
            CertificateStore::create_authority(&dir, &fleet, days)?;
            output::line(format_args!(
                "{} is the authority of fleet {fleet}. Keep {} secret: its owner can admit any node to the fleet.",
                dir.join("authority").display(),
                dir.join("authority/ca.key").display()
            ))
        }
        CertCommand::Node { name, roles, serves, address, validity } => {
            check_served(&roles, &serves)?;
            let (roles, serves) = (roles.into_iter().collect(), serves.into_iter().collect());
            let principal = Principal::Node { name, roles, serves };
            issue(&dir, principal, &address, validity.days)
        }
        CertCommand::Person { name, scope, missions, validity } => {
            issue(&dir, Principal::Person { name, scope, missions }, &[], validity.days)
        }
        CertCommand::Renew { name, validity } => renew(&dir, &name, validity.days),
        CertCommand::Revoke { name } => {
            let written = CertificateStore::open(&dir)?.revoke(&name)?;
            let files = written.iter().map(|file| format!("  {}", file.display())).collect::<Vec<_>>().join("\n");
            output::line(format_args!("the certificate of {name} is revoked. Copy the list to every machine:\n{files}"))
        }
        CertCommand::Show { json } => show(&CertificateStore::open(&dir)?.certificates()?, json),
    }
}

/// Checks that hosts, and only hosts, serve robots or people.
fn check_served(roles: &[NodeRole], serves: &[ServedName]) -> Result<(), Failure> {
    match (roles.contains(&NodeRole::Host), serves.is_empty()) {
        (true, true) => Err(Failure::Usage(
            "the role host needs --serves: names of robots and of roles of people, or '*' for all".to_owned(),
        )),
        (false, false) => Err(Failure::Usage("--serves is for nodes with the role host".to_owned())),
        (true, false) | (false, true) => Ok(()),
    }
}

fn issue(dir: &Path, principal: Principal, addresses: &[String], days: u32) -> Result<(), Failure> {
    let certs = CertificateStore::open(dir)?;
    let identity = Identity { fleet: certs.fleet()?, principal };
    let folder = certs.issue(&identity, addresses, days, false)?;
    print_issued(&folder, &identity, days)
}

fn renew(dir: &Path, name: &str, days: u32) -> Result<(), Failure> {
    let certs = CertificateStore::open(dir)?;
    let entry = certs.certificate(name)?;
    let folder = certs.issue(&entry.identity, &entry.addresses, days, true)?;
    print_issued(&folder, &entry.identity, days)
}

fn print_issued(folder: &Path, identity: &Identity, days: u32) -> Result<(), Failure> {
    let folder = folder.display();
    let valid_for = count(days, "day", "days");
    output::line(format_args!(
        "{folder}: certificate of {} in fleet {}, valid for {valid_for}",
        identity.principal, identity.fleet
    ))
}

fn show(entries: &[CertificateEntry], json: bool) -> Result<(), Failure> {
    if json {
        return output::json(&entries.iter().map(CertificateLine::of).collect::<Vec<_>>());
    }
    let mut rows = vec![["NAME", "PRINCIPAL", "VALID FOR", "SERIAL"].map(str::to_owned).to_vec()];
    rows.extend(entries.iter().map(|entry| {
        let state = match entry.state {
            CertificateState::Valid { days } => count(days, "day", "days"),
            CertificateState::Expired => "expired".to_owned(),
            CertificateState::Revoked => "revoked".to_owned(),
        };
        vec![entry.name.clone(), entry.identity.principal.to_string(), state, hex(&entry.serial)]
    }));
    output::line(output::table(&rows))
}

/// A certificate, as `--json` prints it.
#[derive(serde::Serialize)]
struct CertificateLine<'a> {
    name: &'a str,
    identity: String,
    addresses: &'a [String],
    /// `valid`, `expired` or `revoked`.
    state: &'static str,
    days_left: Option<u64>,
    valid_until_s: u64,
    /// Hexadecimal.
    serial: String,
}

impl CertificateLine<'_> {
    fn of(entry: &CertificateEntry) -> CertificateLine<'_> {
        let (state, days_left) = match entry.state {
            CertificateState::Valid { days } => ("valid", Some(days)),
            CertificateState::Expired => ("expired", None),
            CertificateState::Revoked => ("revoked", None),
        };
        CertificateLine {
            name: &entry.name,
            identity: entry.identity.to_string(),
            addresses: &entry.addresses,
            state,
            days_left,
            valid_until_s: entry.expires.as_secs(),
            serial: hex(&entry.serial),
        }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
