//! Zones that grow and grow: the search goes ahead of their growth.

use super::{compare, states};
use crate::cells::Text;

/// A heartbeat comes every 4 msec while an action lasts for 100 to 300 msec, so the same control is reached with zones that grow
/// by 4 msec each. The search goes ahead of this growth, and still finds what happens only at times in between.
#[test]
fn a_zone_that_grows_and_grows_is_expanded_once() {
    let text = |check: &str| {
        format!(
            "cell long;\ntick 1 msec;\nnode left; node right;\nlink left -- right delay 1 msec;\n\
            task first on left\nport alive(n: int8) usage = response user_list = {{second}} time_out = 20 msec class = 2;\n\
            var begun: bool; var done: bool;\nbegin\nbegun := true; run weld takes 100..300 msec; done := true;\n\
            loop delay 1 sec; end;\nend first;\n\
            task second on right standby of first\nuse_port alive(n: int8) usage = query;\nbegin\nloop delay 1 sec; end;\n\
            takeover\ndelay 1 msec;\nend second;\n\
            couple work first -> second lease 12 msec takeover 60 msec every 4 msec via alive;\n\
            check c: {check};\n"
        )
    };
    let cases = [
        ("never first.done", (true, true)),
        ("first.begun leads first.done within 180 msec", (true, true)),
        ("first.begun leads first.done within 300 msec", (false, true)),
        // The first path to the finding is at times that cannot occur, so the search is repeated without acceleration.
        ("first.begun leads first.done within 299 msec", (true, false)),
    ];
    for (check, (is_found, is_less)) in cases {
        let mut cell = Text::new(&text(check));
        let compared = compare(check, &mut cell, 10 * states()).expect("it is small");
        assert_eq!(2 * compared.reduced < compared.plain, is_less, "{check}: {compared:?}");
        assert_eq!(compared.findings > 0, is_found, "{check}: {compared:?}");
    }
}
