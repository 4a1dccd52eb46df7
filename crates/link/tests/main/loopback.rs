//! The real transport, on the loopback interface and a port that the system chooses.

use std::net::UdpSocket;
use std::time::Duration;

use telepulse_link::net::{Listener, ReceiveOptions, SendOptions, send};
use telepulse_link::record::verify_log;
use telepulse_link::{Error, Pace, ReceiverSettings, SenderSettings, StreamHeader};

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

#[test]
fn law_a_recording_crosses_a_real_socket_bit_for_bit() {
    let mut samples: Vec<f64> = (0..20_000).map(|k| (f64::from(k) * 0.013).sin()).collect();
    // A NaN with a payload, negative zero, the smallest subnormal number.
    samples[77] = f64::from_bits(0x7ff0_dead_beef_0001);
    samples[78] = -0.0;
    samples[79] = f64::from_bits(1);
    let header = StreamHeader::describe(&samples, "mm", "sine", 125.0).unwrap();
    let listener = Listener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let mut log = Vec::new();
    let (received, report) = std::thread::scope(|scope| {
        let doctor = scope.spawn(|| {
            let mut n_seen = 0;
            let options = ReceiveOptions { total_timeout: seconds(30), ..ReceiveOptions::default() };
            let received = listener.receive(&options, &mut log, &mut |arrived| {
                n_seen += arrived.delivered.samples.len() as u64;
                assert_eq!(arrived.samples, n_seen);
            });
            assert_eq!(n_seen, 20_000);
            received
        });
        // A stray datagram first: it must not become the sender.
        let stray = UdpSocket::bind("127.0.0.1:0").unwrap();
        stray.send_to(b"hello?", address).unwrap();
        let mut last = 0;
        let options = SendOptions { total_timeout: seconds(30), ..SendOptions::default() };
        let report = send(address, &header, &samples, &options, &mut |progress| {
            assert!(progress.samples > last && progress.n_samples == 20_000);
            last = progress.samples;
        });
        assert_eq!(last, 20_000);
        (doctor.join().unwrap().unwrap(), report.unwrap())
    });
    let bits = |samples: &[f64]| samples.iter().map(|s| s.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&received.samples), bits(&samples));
    assert_eq!(received.header, header);
    assert_eq!(received.session, report.session);
    assert!(received.summary.bit_exact);
    assert_eq!(received.summary.packets.truncated, 1);
    let proof = verify_log(&log[..], &samples).unwrap();
    assert_eq!((proof.n_samples, proof.n_frames), (20_000, report.n_frames));
}

#[test]
fn law_real_time_pace_takes_the_recording_s_time() {
    let samples = vec![0.5; 50];
    let header = StreamHeader::describe(&samples, "mm", "0.2 s", 250.0).unwrap();
    let listener = Listener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::scope(|scope| {
        let doctor = scope.spawn(|| {
            let options = ReceiveOptions { total_timeout: seconds(30), ..ReceiveOptions::default() };
            listener.receive(&options, &mut std::io::sink(), &mut |_| ())
        });
        let sender = SenderSettings { pace: Pace::RealTime, ..SenderSettings::default() };
        let options = SendOptions { sender, total_timeout: seconds(30) };
        let report = send(address, &header, &samples, &options, &mut |_| ()).unwrap();
        // The last of 50 samples exists 49 periods of 4 ms after the first.
        assert!(report.elapsed >= Duration::from_millis(196), "{:?}", report.elapsed);
        assert_eq!(report.n_frames, 10);
        assert_eq!(doctor.join().unwrap().unwrap().samples, samples);
    });
}

#[test]
fn edge_nobody_there_ends_both_sides_with_a_typed_error() {
    let listener = Listener::bind("127.0.0.1:0").unwrap();
    let options =
        ReceiveOptions { receiver: ReceiverSettings::default(), total_timeout: Duration::from_millis(50) };
    let mut log = Vec::new();
    let nobody = listener.receive(&options, &mut log, &mut |_| ());
    let allowed = Duration::from_millis(50);
    assert_eq!(nobody, Err(Error::NoStream { allowed, corrupted: 0, wrong_version: 0, foreign: 0 }));
    assert!(log.is_empty());

    // The listener does not answer any more, but its port is still bound.
    let header = StreamHeader::describe(&[1.0], "mm", "", 125.0).unwrap();
    let max_silence = Duration::from_millis(50);
    let sender = SenderSettings { max_silence, ..SenderSettings::default() };
    let options = SendOptions { sender, total_timeout: seconds(5) };
    let error = send(listener.local_addr().unwrap(), &header, &[1.0], &options, &mut |_| ()).unwrap_err();
    assert!(matches!(error, Error::PeerSilent { after, .. } if after == max_silence), "{error}");
}

#[test]
fn edge_an_address_that_is_none_is_refused() {
    let header = StreamHeader::describe(&[1.0], "mm", "", 125.0).unwrap();
    let error = send("not an address", &header, &[1.0], &SendOptions::default(), &mut |_| ()).unwrap_err();
    assert!(matches!(error, Error::Io { action: "resolve the address", .. }), "{error}");
    assert!(Listener::bind("192.0.2.1:9").is_err());
}
