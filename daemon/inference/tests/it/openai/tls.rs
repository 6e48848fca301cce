//! Servers with `https://`. The tests create the certificates.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use peernet_inference::{Bank, InferenceError};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair, date_time_ymd};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ServerConfig, crypto::ring};

use super::scripted_server::tls_stream;
use super::*;
use crate::recording_requester::run_cancelled_by;

/// Variable with the file of trusted authorities. Each test sets it for a separate process, because the tests of one
/// process share its environment.
const ROOTS_VARIABLE: &str = "SSL_CERT_FILE";

/// Runs `test` in a separate process, with the path of the file of trusted authorities. The first call starts the
/// process, which runs the test function `name` again. The variable is set there, so the second call runs `test`.
fn with_file_of_authorities(name: &str, test: impl FnOnce(&Path)) {
    if let Some(file) =
        std::env::var_os(ROOTS_VARIABLE).map(PathBuf::from).filter(|file| file.ends_with("tls-test.pem"))
    {
        return test(&file);
    }
    let folder = tempfile::tempdir().expect("can be made");
    let output = Command::new(std::env::current_exe().expect("is known"))
        .args(["--exact", "--nocapture", &format!("openai::tls::{name}")])
        .env(ROOTS_VARIABLE, folder.path().join("tls-test.pem"))
        .env_remove("SSL_CERT_DIR")
        .output()
        .expect("can be started");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success() && text.contains("1 passed"),
        "{text}{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Certificate authority.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

impl Authority {
    fn new(name: &str) -> Self {
        let key = KeyPair::generate().expect("has a key");
        let mut params = CertificateParams::new(vec![]).expect("is valid");
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let pem = params.self_signed(&key).expect("can be signed").pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// Returns a server's configuration with a certificate of this authority.
    fn server(&self, params: &CertificateParams) -> Arc<ServerConfig> {
        let key = KeyPair::generate().expect("has a key");
        let certificate = params.signed_by(&key, &self.issuer).expect("can be signed");
        server_config(certificate.der().clone(), &key)
    }
}

fn server_config(certificate: CertificateDer<'static>, key: &KeyPair) -> Arc<ServerConfig> {
    let key = PrivateKeyDer::try_from(key.serialize_der()).expect("is a key");
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("has versions")
        .with_no_client_auth()
        .with_single_cert(vec![certificate], key);
    Arc::new(config.expect("certificate and key match"))
}

fn certificate_for(name: &str) -> CertificateParams {
    CertificateParams::new(vec![name.to_owned()]).expect("is a name")
}

fn answer() -> Vec<Step> {
    vec![head(), content("yes"), finish("stop"), done()]
}

/// Returns the text of the error with which a model cannot be loaded.
fn refusal(url: &str) -> String {
    let error = bank_at(url, "").load(&"vlm".parse().expect("is a name"), None).expect_err("is refused");
    assert!(!error.to_peer("vlm", "gpu-1").contains(url), "a peer does not see the address");
    error.to_string()
}

fn bank_at(url: &str, more: &str) -> Bank {
    bank(&[&format!("name = 'vlm'\nkind = 'openai'\nurl = {url:?}\nmodel = 'llava'\n{more}")])
}

#[test]
fn answer_over_https_has_times() {
    with_file_of_authorities("answer_over_https_has_times", |file| {
        let authority = Authority::new("a");
        fs::write(file, &authority.pem).expect("can be written");
        let config = authority.server(&certificate_for("127.0.0.1"));
        let server = ScriptedServer::start_tls(vec![answer(), answer()], config);
        assert!(server.url().starts_with("https://127.0.0.1:"));
        let bank = bank_at(&server.url(), "api_key_env = 'PATH'");
        let pool = loaded(&bank, "vlm");
        for _ in 0..2 {
            let finished = run(&pool, text("Is it open?"));
            assert_eq!(parts(&finished.result.expect("answers")).0, "yes");
            let request = server.request();
            assert!(request.head.starts_with("post /v1/chat/completions http/1.1\r\n"), "{}", request.head);
            assert!(request.head.contains("authorization: bearer "), "{}", request.head);
            let tree = finished.recorder.finish();
            let connect = value(&tree, "connect").expect("is recorded");
            assert!(value(&tree, "time-to-first-token").is_some_and(|first| connect < first));
        }
    });
}

#[test]
fn self_signed_certificate_is_accepted_if_trusted() {
    with_file_of_authorities("self_signed_certificate_is_accepted_if_trusted", |file| {
        let key = KeyPair::generate().expect("has a key");
        let mut params = certificate_for("127.0.0.1");
        params.is_ca = IsCa::ExplicitNoCa;
        let certificate = params.self_signed(&key).expect("can be signed");
        fs::write(file, certificate.pem()).expect("can be written");
        let server =
            ScriptedServer::start_tls(vec![answer()], server_config(certificate.der().clone(), &key));
        assert!(run(&loaded(&bank_at(&server.url(), ""), "vlm"), text("a")).result.is_ok());

        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let certificate = params.self_signed(&key).expect("can be signed");
        fs::write(file, certificate.pem()).expect("can be written");
        let server = ScriptedServer::start_tls(vec![], server_config(certificate.der().clone(), &key));
        let error = refusal(&server.url());
        assert!(
            error.contains("CaUsedAsEndEntity") && error.ends_with("(basicConstraints CA:FALSE)"),
            "{error}"
        );
    });
}

#[test]
fn untrusted_certificates_are_refused_with_reason() {
    with_file_of_authorities("untrusted_certificates_are_refused_with_reason", |file| {
        let [trusted, other, recreated] = ["a", "b", "a"].map(Authority::new);
        fs::write(file, &trusted.pem).expect("can be written");
        let mut expired = certificate_for("127.0.0.1");
        (expired.not_before, expired.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(2021, 1, 1));
        let unknown = format!(
            "its certificate is signed by no authority of SSL_CERT_FILE={}: add this authority to those of the operating \
             system, or name a PEM file with all trusted authorities in the environment variable SSL_CERT_FILE",
            file.display()
        );
        let certificate = certificate_for("127.0.0.1");
        for (config, reason, remedy) in [
            (other.server(&certificate), "certificate: UnknownIssuer", unknown.clone()),
            (recreated.server(&certificate), "certificate: BadSignature", unknown),
            (
                trusted.server(&certificate_for("gpu.example")),
                "certificate not valid for name \"127.0.0.1\"",
                "write a name of the certificate into url".to_owned(),
            ),
            (
                trusted.server(&expired),
                "certificate expired",
                "renew the certificate, or set the clock of this host".to_owned(),
            ),
        ] {
            let server = ScriptedServer::start_tls(vec![], config);
            let error = refusal(&server.url());
            let address = server.url().replace("https://", "").replace("/v1", "");
            let start = format!(
                "model vlm at {}: cannot open a TLS connection to its server {address}: ",
                server.url()
            );
            assert!(error.starts_with(&start) && error.contains(reason), "{error}");
            assert!(error.ends_with(&remedy), "{error}");
        }
    });
}

#[test]
fn server_without_tls_is_refused_with_reason() {
    with_file_of_authorities("server_without_tls_is_refused_with_reason", |file| {
        fs::write(file, Authority::new("a").pem).expect("can be written");
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
        let url = format!("https://{}/v1", listener.local_addr().expect("is bound"));
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().expect("is accepted");
            assert_ne!(stream.read(&mut [0; 4096]).expect("sends its hello"), 0);
            stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n").expect("is received");
        });
        let error = refusal(&url);
        assert!(error.ends_with("write http:// into url if this port has no TLS"), "{error}");
    });
}

#[test]
fn missing_authorities_are_refused_with_reason() {
    with_file_of_authorities("missing_authorities_are_refused_with_reason", |file| {
        for text in [None, Some("no certificates")] {
            if let Some(text) = text {
                fs::write(file, text).expect("can be written");
            }
            let errors = bank_at("https://gpu/v1", "").check();
            let [(0, error)] = &errors[..] else { panic!("{errors:?}") };
            let error = error.to_string();
            for part in ["vlm", "url", &format!("SSL_CERT_FILE={}", file.display()), "ca-certificates"] {
                assert!(error.contains(part), "{part}: {error}");
            }
        }
    });
}

/// Starts a server that answers `/models` on the first connection and never answers the handshake of the second
/// connection. Returns the URL of the server and a receiver of two messages: the first says that the second handshake
/// has begun, the second that the client has closed the second connection.
fn server_with_stalled_handshake(file: &Path) -> (String, Receiver<()>) {
    let authority = Authority::new("a");
    fs::write(file, &authority.pem).expect("can be written");
    let config = authority.server(&certificate_for("127.0.0.1"));
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let url = format!("https://{}/v1", listener.local_addr().expect("is bound"));
    let (sender, events) = sync_channel(2);
    thread::spawn(move || {
        let accept = || listener.accept().expect("is accepted").0;
        let mut check_stream = tls_stream(accept(), &config).expect("the handshake is complete");
        assert_ne!(check_stream.read(&mut [0; 4096]).expect("sends a request"), 0);
        check_stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}").expect("is received");
        let mut request_stream = accept();
        assert_ne!(request_stream.read(&mut [0]).expect("sends its hello"), 0);
        sender.send(()).expect("the test is running");
        request_stream.read_to_end(&mut Vec::new()).expect("is closed cleanly");
        sender.send(()).expect("the test is running");
    });
    (url, events)
}

/// Waits for the next message of a server.
fn wait_for(events: &Receiver<()>) {
    events.recv_timeout(Duration::from_secs(60)).expect("the server sends a message");
}

#[test]
fn stalled_handshake_ends_at_limit() {
    with_file_of_authorities("stalled_handshake_ends_at_limit", |file| {
        let (url, events) = server_with_stalled_handshake(file);
        let bank = bank_at(&url, "first_token_timeout_ms = 120");
        let finished = run(&loaded(&bank, "vlm"), text("a"));
        let Err(InferenceError::Server { reason, .. }) = finished.result else {
            panic!("the request did not fail")
        };
        let expected =
            "its server sent no token within 120 ms; raise first_token_timeout_ms if it needs longer";
        assert_eq!(reason, expected);
        assert_eq!(value(&finished.recorder.finish(), "connect"), None, "the connection was not open");
        (0..2).for_each(|_| wait_for(&events));
    });
}

#[test]
fn cancellation_ends_stalled_handshake() {
    with_file_of_authorities("cancellation_ends_stalled_handshake", |file| {
        let (url, events) = server_with_stalled_handshake(file);
        let bank = bank_at(&url, "");
        let result = run_cancelled_by(&loaded(&bank, "vlm"), text("a"), || wait_for(&events));
        assert!(matches!(result, Err(InferenceError::Cancelled { .. })), "{result:?}");
        wait_for(&events);
    });
}
