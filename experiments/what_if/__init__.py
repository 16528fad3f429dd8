"""What would have happened: outcomes of branches, and who could have prevented an incident."""
