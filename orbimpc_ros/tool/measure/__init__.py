"""How `orbimpc bench` measures: instances, duels on them, live nodes, tables and pictures."""
