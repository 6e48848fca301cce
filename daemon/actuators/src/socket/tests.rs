//! Tests with controllers on real sockets.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use peernet_clock::{ClockIdentity, SystemClock};
use peernet_logger::HostId;
use peernet_sample::{Description, MediaType, Sample};

use super::*;
use crate::ActuatorConfig;

fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "system")))
}

fn actuator(address: &str, keys: &str) -> Box<dyn Actuator> {
    let config = format!("kind = 'socket'\naddress = '{address}'\n{keys}");
    let config: ActuatorConfig = toml::from_str(&config).expect("reads");
    config.build(&clock()).expect("is built without a controller, too")
}

fn act(actuator: &mut dyn Actuator, answer: &str) -> Result<Feedback, String> {
    let answer = Sample::from_part(Description::unshaped(MediaType::Text), answer.to_owned().into());
    let mut recorder = Recorder::new(clock(), HostId::random());
    actuator.act(Action::first(&answer, "eye"), &mut recorder).map_err(|error| error.to_string())
}

/// Starts a controller that serves connections one after the other; `serve` gets the index of each connection. Returns
/// the controller's address and its thread.
fn tcp_controller(
    connections: usize,
    mut serve: impl FnMut(usize, BufReader<TcpStream>) + Send + 'static,
) -> (String, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("there is a port");
    let address = format!("tcp://{}", listener.local_addr().expect("it has one"));
    let serving = thread::spawn(move || {
        for number in 0..connections {
            let (stream, _) = listener.accept().expect("is connected to");
            serve(number, BufReader::new(stream));
        }
    });
    (address, serving)
}

/// Reads a line; `null` if the actuator closes the connection before it sends a line.
fn read_line(stream: &mut BufReader<TcpStream>) -> serde_json::Value {
    let mut line = String::new();
    stream.read_line(&mut line).expect("is sent");
    serde_json::from_str(&line).unwrap_or(serde_json::Value::Null)
}

#[test]
fn tcp_controller_gets_lines_and_answers_each() {
    let (address, serving) = tcp_controller(1, |_, mut stream| {
        for (number, reply) in
            ["{\"reward\": 0.5}", "{\"reward\": 1, \"success\": true, \"episode_ended\": true}"]
                .into_iter()
                .enumerate()
        {
            let line = read_line(&mut stream);
            assert_eq!(
                (&line["answer"], &line["source"]),
                (&["left", "right"][number].into(), &"eye".into())
            );
            // The line arrives in two segments, as a network may deliver them.
            let (start, end) = reply.split_at(5);
            stream.get_mut().write_all(start.as_bytes()).expect("is read");
            stream.get_mut().flush().expect("is sent");
            stream.get_mut().write_all(format!("{end}\n").as_bytes()).expect("is read");
        }
    });
    let mut actuator = actuator(&address, "feedback = true");
    assert!(actuator.blocks() && !actuator.resets());
    assert_eq!(act(&mut *actuator, "left"), Ok(Feedback { reward: Some(0.5), ..Feedback::default() }));
    let final_feedback = Feedback { episode_ended: true, success: Some(true), reward: Some(1.0) };
    assert_eq!(act(&mut *actuator, "right"), Ok(final_feedback));
    serving.join().expect("got what it expected");
}

#[test]
fn connection_is_replaced_after_controller_closed_it() {
    let (address, serving) = tcp_controller(2, |number, mut stream| {
        assert_eq!(read_line(&mut stream)["answer"], ["one", "two"][number]);
    });
    let mut actuator = actuator(&address, "");
    act(&mut *actuator, "one").expect("is sent");
    // The controller has closed the first connection. A line that is sent before the actuator notices is lost. The
    // loop therefore sends the line again until the controller has read it.
    while !serving.is_finished() {
        let _ = act(&mut *actuator, "two");
        thread::yield_now();
    }
    serving.join().expect("got both");
}

#[test]
fn late_feedback_is_not_taken_for_next_action() {
    let (release, released) = std::sync::mpsc::sync_channel::<()>(1);
    let (address, _serving) = tcp_controller(usize::MAX, move |number, mut stream| {
        read_line(&mut stream);
        if number == 0 {
            // The controller replies only after the actuator has given up.
            released.recv().expect("the test continues");
            let _ = stream.get_mut().write_all(b"{\"reward\": 666}\n");
        } else {
            // The actuator may have given up on this connection as well.
            let _ = stream.get_mut().write_all(b"{\"reward\": 2}\n");
        }
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 50");
    let error = act(&mut *actuator, "one").expect_err("no feedback comes");
    assert!(error.contains("did not send feedback within 50 ms"), "{error}");
    release.send(()).expect("the controller waits");
    let second = loop {
        match act(&mut *actuator, "two") {
            Ok(feedback) => break feedback,
            Err(error) => assert!(error.contains("within 50 ms"), "{error}"),
        }
    };
    assert_eq!(second.reward, Some(2.0));
}

#[test]
fn missing_line_feed_is_named() {
    let (address, _serving) = tcp_controller(1, |_, mut stream| {
        read_line(&mut stream);
        stream.get_mut().write_all(b"{\"reward\": 1}").expect("is sent");
        // The actuator closes the connection after its timeout.
        let _ = stream.read(&mut [0]);
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 300");
    let error = act(&mut *actuator, "one").expect_err("no line comes");
    assert!(error.contains("sent {\"reward\": 1} and no line feed within 300 ms"), "{error}");
}

#[test]
fn error_gives_reason_why_feedback_is_wrong() {
    let replies: [&'static [u8]; 4] = [b"{\"rewrad\": 1}\n", b"hello\n", b"", &[b'x'; 70_000]];
    let (address, serving) = tcp_controller(replies.len(), move |number, mut stream| {
        read_line(&mut stream);
        let _ = stream.get_mut().write_all(replies[number]);
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 5000");
    for part in
        ["unknown field `rewrad`", "sent \"hello\" as feedback", "closed the connection", "more than 65507"]
    {
        let error = act(&mut *actuator, "go").expect_err(part);
        assert!(error.contains(part), "{error}");
    }
    serving.join().expect("served all");
}

#[test]
fn greeting_is_refused_as_feedback_on_first_answer() {
    let (address, serving) = tcp_controller(1, |_, mut stream| {
        stream.get_mut().write_all(b"welcome\n").expect("is read");
        let _ = stream.read(&mut [0; 1]);
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 5000");
    // The actuator does not read from a new connection before it sends the answer. The greeting is then read as
    // feedback.
    let error = act(&mut *actuator, "go").expect_err("a greeting is no feedback");
    assert!(error.contains("welcome"), "{error}");
    serving.join().expect("ends");
}

#[test]
fn udp_controller_gets_datagrams_and_answers() {
    let controller = UdpSocket::bind("127.0.0.1:0").expect("there is a port");
    let address = format!("udp://{}", controller.local_addr().expect("it has one"));
    let serving = thread::spawn(move || {
        let mut buffer = [0; 1000];
        for (answer, reward) in [("left", 1), ("right", 2)] {
            let (read, from) = controller.recv_from(&mut buffer).expect("is sent");
            let line: serde_json::Value = serde_json::from_slice(&buffer[..read]).expect("is JSON");
            assert_eq!(line["answer"], answer);
            // The second datagram is a duplicate, which a network may make.
            for _ in 0..2 {
                let reply = format!("{{\"iteration\": {}, \"reward\": {reward}}}", line["iteration"]);
                controller.send_to(reply.as_bytes(), from).expect("is sent");
            }
        }
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 5000");
    for (iteration, answer) in [(1, "left"), (2, "right")] {
        let sample = Sample::from_part(Description::unshaped(MediaType::Text), answer.into());
        let action = Action { iteration, ..Action::first(&sample, "eye") };
        let feedback = actuator.act(action, &mut Recorder::new(clock(), HostId::random())).expect("answers");
        assert_eq!(feedback.reward, Some(iteration as f64));
    }
    serving.join().expect("got both");
}

#[test]
fn error_names_iteration_of_wrong_feedback() {
    let (address, serving) = tcp_controller(1, |_, mut stream| {
        read_line(&mut stream);
        stream.get_mut().write_all(b"{\"iteration\": 7, \"reward\": 1}\n").expect("is read");
        let _ = stream.read(&mut [0; 1]);
    });
    let mut actuator = actuator(&address, "feedback = true\ntimeout_ms = 1000");
    let error = act(&mut *actuator, "go").expect_err("iteration 1 has no feedback");
    assert!(error.contains("sent feedback on iteration 7 and none on iteration 1 within 1000 ms"), "{error}");
    drop(actuator);
    serving.join().expect("ends");
}

#[test]
fn missing_controller_fails_each_action() {
    // The listener is closed at the end of the statement, so nothing listens at its address.
    let address =
        TcpListener::bind("127.0.0.1:0").expect("there is a port").local_addr().expect("it has one");
    let mut actuator = actuator(&format!("tcp://{address}"), "");
    for _ in 0..2 {
        let error = act(&mut *actuator, "go").expect_err("nothing listens");
        assert!(error.contains("cannot connect to the controller at tcp://127.0.0.1:"), "{error}");
    }
}

#[test]
fn try_build_connects_without_acting() {
    let (address, serving) = tcp_controller(1, |_, mut stream| {
        let mut sent = Vec::new();
        stream.read_to_end(&mut sent).expect("is closed");
        assert_eq!(sent, b"", "no line is sent");
    });
    let config = |address: &str| -> ActuatorConfig {
        toml::from_str(&format!("kind = 'socket'\naddress = '{address}'")).expect("reads")
    };
    config(&address).try_build(&clock()).expect("the controller listens");
    serving.join().expect("was connected to");
    // The controller has served its only connection and has closed its port.
    let closed_port = config(&address);
    let error = closed_port.try_build(&clock()).expect_err("the port is closed").to_string();
    assert!(error.starts_with(&format!("cannot connect to the controller at {address}: ")), "{error}");
    assert_eq!(closed_port.remarks(&clock()), [error], "remarks() and try_build() report the same error");
    closed_port.check(&clock()).expect("the configuration is valid");

    let udp_address =
        UdpSocket::bind("127.0.0.1:0").expect("there is a port").local_addr().expect("it has one");
    config(&format!("udp://{udp_address}")).try_build(&clock()).expect("a UDP address needs no listener");
    let unknown = config("udp://no-such-host.invalid:9000");
    let error = unknown.try_build(&clock()).expect_err("RFC 6761 reserves the name").to_string();
    assert!(
        error.contains("udp://no-such-host.invalid:9000") && error.contains("correct the name"),
        "{error}"
    );
}

#[test]
fn timeout_above_a_day_is_refused() {
    let config = "kind = 'socket'\naddress = 'udp://arm:9000'\ntimeout_ms = 86400001";
    let config: ActuatorConfig = toml::from_str(config).expect("reads");
    let error = config.check(&clock()).expect_err("is too long").to_string();
    assert!(error.contains("86400000"), "{error}");
    assert_eq!(config.facts(), [("Actuator".to_owned(), "udp://arm:9000".to_owned())]);
    let error =
        toml::from_str::<ActuatorConfig>("kind = 'socket'\naddress = 'arm'").expect_err("has no port");
    assert!(error.to_string().contains("write udp://host:port"), "{error}");
}
