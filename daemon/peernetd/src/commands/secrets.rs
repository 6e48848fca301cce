//! The command `peernetd clear-host-secret`.

use peernet_cli::exit::{Exit, Failure};
use peernet_cli::output::{print_to_stderr, print_to_stdout};
use peernet_store::maintenance::{ClearSecretError, clear_host_secret};

use super::DatabaseArgument;
use crate::log;

/// Deletes the secret of a host, so that the next agent with the host's id is accepted.
pub(crate) fn clear_secret(database: DatabaseArgument, host: &str) -> Exit {
    let _log = log::install_temporary();
    let result = database.path().and_then(|database| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| Failure::new(Exit::Unavailable, error))?;
        let result = runtime.block_on(clear_host_secret(&database, host));
        result.map_err(|error| Failure::new(exit_code(&error), error))
    });
    match result {
        Ok(cleared) if cleared.existed => {
            print_to_stdout(format_args!(
                "deleted the secret of {} ({}); the next agent with this host id is accepted",
                cleared.name, cleared.host
            ));
            Exit::Ok
        }
        Ok(cleared) => {
            print_to_stdout(format_args!(
                "{} ({}) has no secret; the next agent with this host id is accepted",
                cleared.name, cleared.host
            ));
            Exit::Ok
        }
        Err(failure) => {
            print_to_stderr(&failure);
            failure.exit
        }
    }
}

fn exit_code(error: &ClearSecretError) -> Exit {
    match error {
        ClearSecretError::NoHost { .. } | ClearSecretError::SeveralHosts { .. } => Exit::Usage,
        ClearSecretError::NotADatabase { .. } => Exit::Data,
        ClearSecretError::Missing(_)
        | ClearSecretError::ForeignLog(_)
        | ClearSecretError::Database { .. } => Exit::Unavailable,
    }
}
