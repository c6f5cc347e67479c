//! `consort cert`: the certificates of a fleet.

use crate::certs::{CertificateEntry, CertificateState, CertificateStore};
use crate::exit::Failure;
use crate::output;
use consort_protocol::count::count;
use consort_protocol::ids::{FleetId, NodeId, PersonId};
use consort_protocol::trust::{AccessScope, Identity, NodeRole, Principal};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Make, renew and revoke the certificates of a fleet
///
/// A fleet whose nodes have certificates is closed: links are encrypted (TLS 1.3), both ends prove who they are, and every
/// message between nodes bears the signature of the node that said it, so that a robot speaks for itself alone whoever relays
/// it. Each node has one folder with what it needs, and is started with `--certs FOLDER`; so have people, who may read,
/// submit or operate.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Args {
    /// The folder of the fleet's certificates. `authority` in it signs for the fleet: keep that on one machine, and a copy safe
    #[arg(long, env = "CONSORT_CERTS_DIR", value_name = "DIR", default_value = "certs", global = true)]
    dir: PathBuf,
    #[command(subcommand)]
    what: What,
}

const EXAMPLES: &str = "\
Examples:
  consort cert init --fleet ward
  consort cert node ada --roles robot,voter
  consort cert node ward-1 --roles voter --address 192.0.2.7
  consort cert node world --roles host,voter
  consort cert person kim --scope submit
  consort cert show

  # certs/ada is copied to ada's machine, certs/kim to Kim's
  consort robot --config ada.toml --certs certs/ada --listen tls/0.0.0.0:7447
  consort missions --certs certs/kim --connect tls/192.0.2.7:7447

  # before a certificate expires, and when a machine is lost
  consort cert renew ada
  consort cert revoke ada";

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Found the authority of a fleet
    Init {
        /// The fleet's name
        #[arg(long, value_name = "NAME")]
        fleet: FleetId,
        /// For how many days it is good: all its certificates end with it
        #[arg(long, value_name = "DAYS", default_value_t = 3650, value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: u32,
    },
    /// Make a node's certificate
    Node {
        /// The node's name: a robot's node is called as the robot
        name: NodeId,
        /// What it may be: robot, voter (keeps the ledger, may coordinate), host (of a world, of bodies, of people)
        #[arg(long, value_name = "ROLES", value_delimiter = ',', required = true)]
        roles: Vec<NodeRole>,
        /// Name or address under which it is reached, for clients that compare it; may be repeated
        #[arg(long, value_name = "HOST")]
        address: Vec<String>,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Make a person's certificate, or a program's that a person answers for
    Person {
        /// The name
        name: PersonId,
        /// What the person may do: read; submit (and cancel) missions; operate (rescue, make nodes leave). Each includes those before
        #[arg(long, value_name = "SCOPE", default_value = "read")]
        scope: AccessScope,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Make a new certificate and key for somebody who has one
    Renew {
        /// The name
        name: String,
        #[command(flatten)]
        validity: ValidityFlag,
    },
    /// Withdraw somebody's certificate
    ///
    /// Every node that has the new list (within 10 s of its being put into its folder) listens to nothing that its bearer signs.
    /// Links are not cut by it: they end when the certificate does.
    Revoke {
        /// The name
        name: String,
    },
    /// Show who has certificates, and for how long
    Show {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
struct ValidityFlag {
    /// For how many days it is good
    #[arg(long, value_name = "DAYS", default_value_t = 90, value_parser = clap::value_parser!(u32).range(1..=36_500))]
    days: u32,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for what is wrong with the folder or a name; nothing was changed.
pub fn run(args: Args) -> Result<(), Failure> {
    let dir = args.dir;
    match args.what {
        What::Init { fleet, days } => {
            CertificateStore::create_authority(&dir, &fleet, days)?;
            output::line(format_args!(
                "{} is the authority of fleet {fleet}. Whoever reads {} can make anybody part of it.",
                dir.join("authority").display(),
                dir.join("authority/ca.key").display()
            ))
        }
        What::Node { name, roles, address, validity } => {
            let bearer = Principal::Node { name, roles: roles.into_iter().collect() };
            issue(&dir, bearer, &address, validity.days)
        }
        What::Person { name, scope, validity } => issue(&dir, Principal::Person { name, scope }, &[], validity.days),
        What::Renew { name, validity } => renew(&dir, &name, validity.days),
        What::Revoke { name } => {
            let written = CertificateStore::open(&dir)?.revoke(&name)?;
            let files = written.iter().map(|file| format!("  {}", file.display())).collect::<Vec<_>>().join("\n");
            output::line(format_args!("{name}'s certificate is revoked. Carry the list to every machine:\n{files}"))
        }
        What::Show { json } => show(&CertificateStore::open(&dir)?.certificates()?, json),
    }
}

fn issue(dir: &Path, bearer: Principal, addresses: &[String], days: u32) -> Result<(), Failure> {
    let certs = CertificateStore::open(dir)?;
    let identity = Identity { fleet: certs.fleet()?, principal: bearer };
    let folder = certs.issue(&identity, addresses, days, false)?;
    tell(&folder, &identity, days)
}

fn renew(dir: &Path, name: &str, days: u32) -> Result<(), Failure> {
    let certs = CertificateStore::open(dir)?;
    let holder = certs.certificate(name)?;
    let folder = certs.issue(&holder.identity, &holder.addresses, days, true)?;
    tell(&folder, &holder.identity, days)
}

fn tell(folder: &Path, identity: &Identity, days: u32) -> Result<(), Failure> {
    let folder = folder.display();
    let good_for = count(days, "day", "days");
    output::line(format_args!("{folder} is for {} of fleet {}, for {good_for}", identity.principal, identity.fleet))
}

fn show(holders: &[CertificateEntry], json: bool) -> Result<(), Failure> {
    if json {
        let holders: Vec<_> = holders.iter().map(described).collect();
        return output::line(json!(holders));
    }
    let mut rows = vec![["NAME", "WHO", "GOOD FOR", "SERIAL"].map(str::to_owned).to_vec()];
    rows.extend(holders.iter().map(|holder| {
        let state = match holder.state {
            CertificateState::Valid { days } => count(days, "day", "days"),
            CertificateState::Expired => "expired".to_owned(),
            CertificateState::Revoked => "revoked".to_owned(),
        };
        vec![holder.name.clone(), holder.identity.principal.to_string(), state, hex(&holder.serial)]
    }));
    output::line(output::table(&rows))
}

fn described(holder: &CertificateEntry) -> serde_json::Value {
    let (state, days) = match holder.state {
        CertificateState::Valid { days } => ("valid", Some(days)),
        CertificateState::Expired => ("expired", None),
        CertificateState::Revoked => ("revoked", None),
    };
    json!({
        "name": holder.name, "identity": holder.identity.to_string(), "addresses": holder.addresses,
        "state": state, "days_left": days, "valid_until_s": holder.expires.as_secs(), "serial": hex(&holder.serial),
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
