//! Where the communication tasks of a node are: in which domain, and at which place there (D186).

use imrs_protocol::TaskId;

/// Where a communication task of the node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Home {
    /// Its position among the node's tasks.
    pub place: usize,
    /// Its domain: the place of that domain's first member.
    pub domain: usize,
    /// Its position among the members of the domain.
    pub member: usize,
}

/// Where the communication tasks of a node are.
#[derive(Debug)]
pub(crate) struct Homes {
    /// For each task of the cell.
    of_task: Box<[Option<Home>]>,
    /// For each task of the node, ascending by task.
    of_place: Box<[Home]>,
}

impl Homes {
    /// The homes of `local`, the tasks of a node, ascending; each with whether it has a script. The cell has `tasks` tasks.
    pub fn new(local: impl Iterator<Item = (TaskId, bool)>, tasks: usize) -> Self {
        let mut of_task = vec![None; tasks];
        let mut of_place = Vec::new();
        let mut scripts: Option<(usize, usize)> = None;
        for (place, (task, scripted)) in local.enumerate() {
            let (domain, member) = if scripted {
                let (domain, count) = scripts.get_or_insert((place, 0));
                *count += 1;
                (*domain, *count - 1)
            } else {
                (place, 0)
            };
            let home = Home { place, domain, member };
            of_place.push(home);
            of_task[task.index()] = Some(home);
        }
        Self { of_task: of_task.into(), of_place: of_place.into() }
    }

    /// The home of `task`, if this node runs it.
    pub fn of(&self, task: TaskId) -> Option<Home> {
        self.of_task.get(task.index()).copied().flatten()
    }

    /// The home of the task at a place of the node.
    pub fn at(&self, place: usize) -> Home {
        self.of_place[place]
    }
}
