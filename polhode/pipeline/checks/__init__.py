"""Whether the data are what they say (data_checks/), and the answer the target's (answer_checks/)."""
